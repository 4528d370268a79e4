"""Scenario, fleet file and graph of swarmabs: everything that is declared."""
