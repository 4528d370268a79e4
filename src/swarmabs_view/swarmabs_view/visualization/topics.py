"""The standard topics that a swarm is shown on, as data: names relative to its namespace, types, quality of service."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import cache
from typing import Any

from swarmabs_config.graph import Qos


@dataclass(frozen=True, slots=True)
class VisualTopic:
    """A topic: its name, the full ROS name of its type, and what its publisher offers."""

    name: str
    ros_type: str
    qos: Qos


JOINT_STATES = VisualTopic("plane/joint_states", "sensor_msgs/msg/JointState", Qos("reliable", 10))
MARKERS = VisualTopic("swarm/markers", "visualization_msgs/msg/MarkerArray", Qos("reliable", 1))
DESCRIPTION = VisualTopic("robot_description", "std_msgs/msg/String", Qos("reliable", 1, "transient_local"))
TF = VisualTopic("tf", "tf2_msgs/msg/TFMessage", Qos("reliable", 100))
CLOCK = VisualTopic("clock", "rosgraph_msgs/msg/Clock", Qos("best_effort", 1))

VISUAL_TOPICS = (JOINT_STATES, MARKERS, DESCRIPTION, TF, CLOCK)
"""All of them. `TF` is there only where `tf2_msgs` is installed: it is not among the wheels of PyPI."""


@cache
def message_class(ros_type: str) -> Any:
    """Return the class of a message type, None if its package is not installed."""
    package, _, name = ros_type.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ModuleNotFoundError:
        return None


def available_topics() -> tuple[VisualTopic, ...]:
    """Return those topics whose types are installed."""
    return tuple(topic for topic in VISUAL_TOPICS if message_class(topic.ros_type) is not None)
