"""Fleets: one file describes robots, hosts, network and security, and each host gets a bundle made from it."""
