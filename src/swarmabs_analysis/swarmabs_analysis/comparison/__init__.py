"""Comparison of runs, message by message: what differs first, how far each field deviates, and what is missing."""

from swarmabs_analysis.comparison.bags import compare_bags
from swarmabs_analysis.comparison.messages import compare_steps
from swarmabs_bag.steps import recorded_steps

__all__ = ["compare_bags", "compare_steps", "recorded_steps"]
