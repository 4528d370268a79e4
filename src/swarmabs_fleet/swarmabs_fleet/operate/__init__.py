"""Operating a swarm in real time: stop, reset, drain, join, status."""
