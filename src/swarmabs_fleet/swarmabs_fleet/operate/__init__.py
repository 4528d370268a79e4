"""An operator's hand and eye on a swarm in real time: stop, reset, drain, join, status."""
