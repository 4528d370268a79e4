"""The fleet file: robots, hosts, coordinators, network, security."""
