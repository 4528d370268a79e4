"""rosbag2's description of a bag, as ROS 2 Jazzy writes it: ``metadata.yaml``, version 9."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from swarmabs_ros.qos import Qos

METADATA_FILE = "metadata.yaml"
"""Name of rosbag2's description beside the MCAP file."""

RECORD_NAME = "rosbag2"
"""Name of the MCAP metadata record that holds the same description, under the key `RECORD_KEY`."""

RECORD_KEY = "serialized_metadata"

ABORTED_KEY = "swarmabs.aborted"
"""Key under ``custom_data`` that says why a bag was aborted; absent from all others."""

_VERSION = 9
_DISTRO = "jazzy"
_INFINITE = (9223372036, 854775807)  # RMW_DURATION_INFINITE: seconds, nanoseconds


@dataclass(frozen=True, slots=True)
class TopicRecord:
    """One topic of a bag: name with namespace, type, hash of the type, and what its publishers offer."""

    name: str
    ros_type: str
    type_hash: str
    qos: Qos


def qos_profile(qos: Qos) -> dict[str, object]:
    """Return the complete profile of an offered QoS, with rosbag2's keys and lower-case names."""
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": qos.reliability,
        "durability": qos.durability,
        "deadline": _infinite(),
        "lifespan": _infinite(),
        "liveliness": "automatic",
        "liveliness_lease_duration": _infinite(),
        "avoid_ros_namespace_conventions": False,
    }


def _infinite() -> dict[str, int]:
    seconds, nanoseconds = _INFINITE
    return {"sec": seconds, "nsec": nanoseconds}


def qos_yaml(qos: Qos) -> str:
    """Return the YAML text of a channel's ``offered_qos_profiles``: a list with the one profile."""
    return dump_yaml([qos_profile(qos)])


def bag_metadata(
    topics: Sequence[tuple[TopicRecord, int]],
    *,
    file: str,
    start: int,
    end: int,
    custom_data: Mapping[str, str],
) -> dict[str, Any]:
    """Return rosbag2's description of a bag of one file.

    Parameters
    ----------
    topics : sequence of (TopicRecord, int)
        All topics with their numbers of messages, also those without any.
    file : str
        Name of the MCAP file, relative to the bag's folder.
    start, end : int
        Log times of the first and the last message in ns, both 0 if there is none.
    custom_data : mapping
        Entries under ``custom_data``.
    """
    count = sum(number for _, number in topics)
    return {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.ros_type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [qos_profile(topic.qos)],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": number,
            }
            for topic, number in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [
            {
                "path": file,
                "starting_time": {"nanoseconds_since_epoch": start},
                "duration": {"nanoseconds": end - start},
                "message_count": count,
            }
        ],
        "custom_data": dict(custom_data) or None,
        "ros_distro": _DISTRO,
    }


def write_metadata(folder: Path, metadata: Mapping[str, Any]) -> None:
    """Write ``metadata.yaml``, whole or not at all: under a temporary name, to the disk, then renamed.

    Raises
    ------
    OSError
        If it cannot be written; nothing of it remains.
    """
    path = folder / METADATA_FILE
    temporary = path.with_suffix(".yaml.tmp")
    try:
        with temporary.open("w", encoding="utf-8") as file:
            file.write(dump_yaml({"rosbag2_bagfile_information": metadata}))
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def dump_yaml(value: object) -> str:
    """Return YAML in block style that keeps the order of keys, one entry per line."""
    return yaml.safe_dump(value, sort_keys=False, default_flow_style=False, allow_unicode=True, width=10_000)
