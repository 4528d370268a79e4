"""Repairing a damaged bag, and reporting what was lost."""

from swarmabs_bag.repair.bag import RepairReport, repair_bag

__all__ = ["RepairReport", "repair_bag"]
