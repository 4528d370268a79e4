"""Comparison of runs, message by message."""
