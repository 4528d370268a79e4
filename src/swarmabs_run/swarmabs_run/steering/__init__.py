"""Steering of a run from outside: the node that orders, its socket, and what speaks to it."""
