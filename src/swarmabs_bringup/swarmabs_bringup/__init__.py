"""Scenarios, orchestration, recorder and command line of swarmabs."""
