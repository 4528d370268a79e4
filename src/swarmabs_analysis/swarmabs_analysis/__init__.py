"""Verification, replay, comparison, export, reports, figures and sweeps of swarmabs."""
