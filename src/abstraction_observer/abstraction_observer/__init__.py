"""Node that gathers the agents' states into the abstract and the auxiliary state."""
