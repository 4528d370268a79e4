"""Runs of swarmabs: start, monitor, steer and end their processes, or simulate them in one process."""
