"""rosbag2's description of a bag, as ROS 2 Jazzy writes it: ``metadata.yaml``, version 9."""

from __future__ import annotations

import os
from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import yaml

from swarmabs_config.graph import Qos
from swarmabs_config.scenario.errors import ScenarioError
from swarmabs_config.scenario.yaml_tree import read_tree

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from mcap.records import Statistics
    from typing_extensions import Self

METADATA_FILE = "metadata.yaml"
"""Name of rosbag2's description beside the MCAP file."""

RECORD_NAME = "rosbag2"
"""Name of the MCAP metadata record that holds the same description, under the key `RECORD_KEY`."""

RECORD_KEY = "serialized_metadata"

ABORTED_KEY = "swarmabs.aborted"
"""Key under ``custom_data`` that says why a bag was aborted; absent from all others."""

REPAIRED_KEY = "swarmabs.repaired"
"""Key under ``custom_data`` that says what `repair_bag` could not save; absent from all others."""

_LONGEST_YAML = 2**20
_VERSION = 9
_DISTRO = "jazzy"
_INFINITE = (9223372036, 854775807)  # RMW_DURATION_INFINITE: seconds, nanoseconds


@dataclass(frozen=True, slots=True)
class TopicRecord:
    """One topic of a bag: name with namespace, type, hash of the type, QoS profiles offered, encoding."""

    name: str
    ros_type: str
    type_hash: str
    profiles: tuple[Mapping[str, object], ...]
    encoding: str = "cdr"


@dataclass(frozen=True, slots=True)
class FileRecord:
    """One file of a bag: name, log times of its first and last message in ns, 0 without any, and their number."""

    name: str
    start: int
    end: int
    message_count: int

    @classmethod
    def of(cls, name: str, numbers: Statistics) -> Self:
        """Return what the numbers of a file say of it."""
        return cls(name, numbers.message_start_time, numbers.message_end_time, numbers.message_count)


def qos_profile(qos: Qos) -> dict[str, object]:
    """Return the complete profile of an offered QoS, with rosbag2's keys and lower-case names."""
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": qos.reliability,
        "durability": qos.durability,
        "deadline": _infinite(),
        "lifespan": _infinite(),
        "liveliness": "manual_by_topic" if qos.lease else "automatic",
        "liveliness_lease_duration": _duration(qos.lease) if qos.lease else _infinite(),
        "avoid_ros_namespace_conventions": False,
    }


def qos_profiles(stated: object) -> tuple[dict[str, object], ...]:
    """Return complete profiles, as version 9 demands them, of what a channel says of its QoS in whichever version.

    What is missing or unknown is filled with the values of this project; anything but a list gives none.
    """
    if not isinstance(stated, list):
        return ()
    return tuple(_completed(profile) for profile in stated if isinstance(profile, dict))


def topic_record(stated: Mapping[str, Any]) -> TopicRecord:
    """Return a topic as ``metadata.yaml`` describes it, in whichever version; a `KeyError` if it has no name."""
    profiles = stated.get("offered_qos_profiles")
    return TopicRecord(
        name=str(stated["name"]),
        ros_type=str(stated.get("type", "")),
        type_hash=str(stated.get("type_description_hash", "")),
        profiles=qos_profiles(load_yaml(profiles) if isinstance(profiles, str) else profiles),
        encoding=str(stated.get("serialization_format", "")),
    )


_NAMES: dict[str, tuple[str, ...]] = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown"),
    "durability": ("system_default", "transient_local", "volatile", "unknown"),
    "liveliness": ("system_default", "automatic", "", "manual_by_topic", "unknown"),
}
"""Names of the policies; older versions write their positions instead."""


def _completed(stated: Mapping[object, object]) -> dict[str, object]:
    profile = qos_profile(Qos("reliable", 10, "volatile"))
    for key, default in profile.items():
        value = stated.get(key)
        if key in _NAMES:
            names = _NAMES[key]
            if isinstance(value, int) and 0 <= value < len(names) and names[value]:
                profile[key] = names[value]
            elif isinstance(value, str) and value.lower() in names:
                profile[key] = value.lower()
        elif isinstance(default, dict):
            if isinstance(value, dict) and all(isinstance(value.get(part), int) for part in ("sec", "nsec")):
                profile[key] = {part: max(0, value[part]) for part in ("sec", "nsec")}
        elif type(value) is type(default):
            profile[key] = value
    return profile


def _duration(seconds: float) -> dict[str, int]:
    sec, nsec = divmod(round(seconds * 1e9), 10**9)
    return {"sec": sec, "nsec": nsec}


def _infinite() -> dict[str, int]:
    seconds, nanoseconds = _INFINITE
    return {"sec": seconds, "nsec": nanoseconds}


def bag_metadata(
    topics: Sequence[tuple[TopicRecord, int]],
    *,
    files: Sequence[FileRecord],
    custom_data: Mapping[str, str],
) -> dict[str, Any]:
    """Return rosbag2's description of a bag.

    All topics have their numbers of messages, also those without any; names of files are relative to the bag's folder.
    """
    filled = [file for file in files if file.message_count]
    start = min((file.start for file in filled), default=0)
    end = max((file.end for file in filled), default=0)
    return {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(number for _, number in topics),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.ros_type,
                    "serialization_format": topic.encoding,
                    "offered_qos_profiles": [deepcopy(profile) for profile in topic.profiles],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": number,
            }
            for topic, number in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start},
                "duration": {"nanoseconds": file.end - file.start},
                "message_count": file.message_count,
            }
            for file in files
        ],
        "custom_data": dict(custom_data) or None,
        "ros_distro": _DISTRO,
    }


def write_metadata(folder: Path, metadata: Mapping[str, Any]) -> None:
    """Write ``metadata.yaml``, whole or not at all: under a temporary name, to the disk, then renamed."""
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


def load_yaml(text: str) -> Any:
    """Read YAML from a bag: plain data only; None if it is not YAML, or too long or too deep to be ours."""
    if len(text) > _LONGEST_YAML:
        return None
    try:
        return read_tree(text, "").plain()
    except ScenarioError:
        return None


def custom_texts(description: object) -> dict[str, str]:
    """Return the entries under ``custom_data`` of rosbag2's description that are texts."""
    custom = description.get("custom_data") if isinstance(description, dict) else None
    if not isinstance(custom, dict):
        return {}
    return {key: value for key, value in custom.items() if isinstance(value, str)}


def dump_yaml(value: object) -> str:
    """Return YAML in block style that keeps the order of keys, one entry per line."""
    return yaml.safe_dump(value, sort_keys=False, default_flow_style=False, allow_unicode=True, width=10_000)
