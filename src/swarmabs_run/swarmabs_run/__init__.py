"""Runs of swarmabs: their processes are started, watched, steered and ended; simulation in one process."""
