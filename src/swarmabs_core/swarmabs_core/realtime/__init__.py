"""The swarm in real time as pure state machines: the same law and sums, driven by a clock instead of by messages."""
