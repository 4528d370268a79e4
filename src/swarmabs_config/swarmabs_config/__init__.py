"""The declarations of swarmabs: scenario, fleet file and graph of topics."""
