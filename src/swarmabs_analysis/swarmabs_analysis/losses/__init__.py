"""What the loss of robots does to a swarm, found before a run by the state machines of its nodes in this process."""
