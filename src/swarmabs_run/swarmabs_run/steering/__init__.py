"""Steering of a running simulation: the steering node, its socket and the client."""
