"""rosbag2's description of a bag in the format of ROS 2 Jazzy: ``metadata.yaml``, version 9."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import yaml

from swarmabs_config.files import write_whole
from swarmabs_config.graph import Qos
from swarmabs_config.model.errors import ScenarioError
from swarmabs_config.scenario.yaml_tree import read_tree

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from mcap.records import Statistics
    from typing_extensions import Self

    from swarmabs_core.messages import Topic

METADATA_FILE = "metadata.yaml"
"""Name of rosbag2's description in the folder of the MCAP file."""

ABORTED_KEY = "swarmabs.aborted"
"""Key under ``custom_data`` with the reason why a bag was aborted; absent otherwise."""

REPAIRED_KEY = "swarmabs.repaired"
"""Key under ``custom_data`` that says what `repair_bag` could not recover; absent otherwise."""

_LONGEST_YAML = 2**20
_VERSION = 9
_DISTRO = "jazzy"


@dataclass(frozen=True, slots=True)
class BagChannel:
    """A topic in a bag, with the namespace in its name; fields that the bag does not give are empty.

    Attributes
    ----------
    qos_profiles : str
        QoS offered by the publishers, as YAML text.
    topic : Topic or None
        The corresponding topic of the swarm, if any.
    """

    name: str
    ros_type: str
    type_hash: str
    qos_profiles: str
    encoding: str = "cdr"
    message_count: int = 0
    topic: Topic | None = None


@dataclass(frozen=True, slots=True)
class FileRecord:
    """A file of a bag: name, log times of the first and last message in ns (0 without messages), number of messages."""

    name: str
    start: int
    end: int
    message_count: int

    @classmethod
    def of(cls, name: str, numbers: Statistics) -> Self:
        """Return the record of a file from its statistics."""
        return cls(name, numbers.message_start_time, numbers.message_end_time, numbers.message_count)


def qos_profile(qos: Qos) -> dict[str, object]:
    """Return the complete profile of an offered QoS, with the keys and lower-case names of rosbag2."""
    return {
        "history": "keep_last",
        "depth": qos.depth,
        "reliability": qos.reliability,
        "durability": qos.durability,
        "deadline": _duration(None),
        "lifespan": _duration(None),
        "liveliness": "manual_by_topic" if qos.lease else "automatic",
        "liveliness_lease_duration": _duration(qos.lease),
        "avoid_ros_namespace_conventions": False,
    }


@lru_cache(maxsize=64)
def _profiles(text: str) -> tuple[dict[str, object], ...]:
    """Return complete profiles, as required by version 9, from the QoS text of a channel in any version.

    Missing or unknown policies get the values of this project; anything but a list gives no profiles.
    """
    stated = load_yaml(text)
    if not isinstance(stated, list):
        return ()
    return tuple(_completed(profile) for profile in stated if isinstance(profile, dict))


def listed_topic(entry: Mapping[str, Any]) -> BagChannel:
    """Return a topic from its entry in ``metadata.yaml`` of any version; raise `KeyError` if it has no name."""
    stated = entry["topic_metadata"]
    profiles = stated.get("offered_qos_profiles")
    return BagChannel(
        name=str(stated["name"]),
        ros_type=str(stated.get("type", "")),
        type_hash=str(stated.get("type_description_hash", "")),
        qos_profiles=profiles if isinstance(profiles, str) else dump_yaml(profiles),
        encoding=str(stated.get("serialization_format", "")),
        message_count=entry["message_count"],
    )


_NAMES: dict[str, tuple[str, ...]] = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown"),
    "durability": ("system_default", "transient_local", "volatile", "unknown"),
    "liveliness": ("system_default", "automatic", "", "manual_by_topic", "unknown"),
}
"""Names of the policies by index; older versions write the index."""


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


def _duration(seconds: float | None) -> dict[str, int]:
    """Return a duration, or RMW_DURATION_INFINITE."""
    sec, nsec = divmod(round(seconds * 1e9), 10**9) if seconds else (9223372036, 854775807)
    return {"sec": sec, "nsec": nsec}


def bag_metadata(
    topics: Sequence[BagChannel],
    *,
    files: Sequence[FileRecord],
    custom_data: Mapping[str, str],
) -> dict[str, Any]:
    """Return rosbag2's description of a bag.

    All topics are listed, even those without messages; file names are relative to the bag's folder.
    """
    filled = [file for file in files if file.message_count]
    start = min((file.start for file in filled), default=0)
    end = max((file.end for file in filled), default=0)
    return {
        "version": _VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": sum(topic.message_count for topic in topics),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.ros_type,
                    "serialization_format": topic.encoding,
                    "offered_qos_profiles": [deepcopy(profile) for profile in _profiles(topic.qos_profiles)],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.message_count,
            }
            for topic in topics
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
    """Write ``metadata.yaml`` completely or not at all (`OSError`), even if power fails."""
    write_whole(folder / METADATA_FILE, dump_yaml({"rosbag2_bagfile_information": metadata}).encode(), sync=True)


def load_yaml(text: str) -> Any:
    """Read YAML from a bag as plain data; None if it is not YAML, or longer or deeper than this project writes."""
    if len(text) > _LONGEST_YAML:
        return None
    try:
        return read_tree(text, "").plain()
    except ScenarioError:
        return None


def custom_texts(description: object) -> dict[str, str]:
    """Return the text entries under ``custom_data`` of rosbag2's description."""
    custom = description.get("custom_data") if isinstance(description, dict) else None
    if not isinstance(custom, dict):
        return {}
    return {key: value for key, value in custom.items() if isinstance(value, str)}


def dump_yaml(value: object) -> str:
    """Return YAML in block style, with the order of keys preserved and one entry per line."""
    return yaml.safe_dump(value, sort_keys=False, default_flow_style=False, allow_unicode=True, width=10_000)
