"""Fleets: one file describes robots, hosts, network and security; each host gets a bundle generated from it."""
