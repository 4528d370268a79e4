"""The swarm in real time: the same law and sums, with a clock instead of waiting; pure state machines."""
