"""Comparison of runs, message by message: the first difference, the deviation of each field, missing messages."""

from swarmabs_analysis.comparison.bags import compare_bags
from swarmabs_analysis.comparison.messages import compare_steps
from swarmabs_bag.run.ordering import recorded_steps

__all__ = ["compare_bags", "compare_steps", "recorded_steps"]
