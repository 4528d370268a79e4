"""Node that sums the robots' states into the abstract and the auxiliary state of the swarm."""
