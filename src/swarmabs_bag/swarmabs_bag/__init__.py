"""Bags: the MCAP file of a run, written so that ROS tools open it, and read with nothing taken on trust."""

from swarmabs_bag.arrays import load_arrays, load_tables
from swarmabs_bag.digest import digest_of
from swarmabs_bag.errors import (
    BagFolderError,
    BagTooLargeError,
    BagWriteError,
    DamagedBagError,
    NotABagError,
    UnknownTypeError,
)
from swarmabs_bag.info import PROVENANCE_FILE, SCENARIO_FILE, BagInfo, ScenarioInfo, TopicInfo, bag_info, render
from swarmabs_bag.reader import BagChannel, BagReader, find_bag, open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_bag.repair_report import RepairReport
from swarmabs_bag.schemas import MessageSchema, message_schema
from swarmabs_bag.writer import BAG_FILE, BagWriter

__all__ = [
    "BAG_FILE",
    "PROVENANCE_FILE",
    "SCENARIO_FILE",
    "BagChannel",
    "BagFolderError",
    "BagInfo",
    "BagReader",
    "BagTooLargeError",
    "BagWriteError",
    "BagWriter",
    "DamagedBagError",
    "MessageSchema",
    "NotABagError",
    "RepairReport",
    "ScenarioInfo",
    "TopicInfo",
    "UnknownTypeError",
    "bag_info",
    "digest_of",
    "find_bag",
    "load_arrays",
    "load_tables",
    "message_schema",
    "open_bag",
    "render",
    "repair_bag",
]
