"""Comparison of runs, message by message: what differs first, how far each field deviates, and what is missing."""

from swarmabs_analysis.comparison.bags import BagSummary, Comparison, compare_bags
from swarmabs_analysis.comparison.messages import (
    FieldDeviation,
    MessageComparison,
    TopicComparison,
    compare_steps,
)
from swarmabs_analysis.comparison.settings import SettingDifference, setting_differences
from swarmabs_analysis.comparison.steps import recorded_steps
from swarmabs_analysis.difference import Difference

__all__ = [
    "BagSummary",
    "Comparison",
    "Difference",
    "FieldDeviation",
    "MessageComparison",
    "SettingDifference",
    "TopicComparison",
    "compare_bags",
    "compare_steps",
    "recorded_steps",
    "setting_differences",
]
