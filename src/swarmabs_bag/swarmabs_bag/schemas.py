"""Schemas of message types, as they stand in a bag: full definition text and RIHS01 hash of the type.

Both come from what rosidl installs with every message package: ``share/PACKAGE/msg/TYPE.msg`` and beside it
the type description ``TYPE.json`` (REP 2011), which also lists every nested type.
"""

from __future__ import annotations

import json
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmabs_bag.errors import UnknownTypeError
from swarmabs_config.scenario.errors import show

if TYPE_CHECKING:
    from collections.abc import Sequence

_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]{,99})/msg/([A-Z][A-Za-z0-9]{,99})")
_SEPARATOR = "=" * 80


@dataclass(frozen=True, slots=True)
class MessageSchema:
    """Definition of a message type: its text in the encoding ``ros2msg``, and RIHS01 hash.

    Behind the text stand, after separator lines, the definitions of all types nested in it.
    """

    name: str
    text: str
    type_hash: str


def ament_prefixes() -> tuple[Path, ...]:
    """Return the prefixes in which ROS packages are looked for, the first before the last.

    These are the entries of ``AMENT_PREFIX_PATH``, then Python's own prefix: ROS wheels install there.
    """
    listed = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return tuple(dict.fromkeys(Path(entry) for entry in (*listed, sys.prefix) if entry))


def message_schema(ros_type: str, *, prefixes: Sequence[Path] | None = None) -> MessageSchema:
    """Find the definition of a message type, such as ``sensor_msgs/msg/JointState``, among the installed packages.

    Raises
    ------
    UnknownTypeError
        If the name is not that of a message type, or a definition is not installed.
    """
    places = ament_prefixes() if prefixes is None else tuple(prefixes)
    description = _description(ros_type, places)
    try:
        nested = sorted(
            entry["type_name"] for entry in description["type_description_msg"]["referenced_type_descriptions"]
        )
        hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
        type_hash = str(hashes[ros_type])
    except (KeyError, TypeError) as error:
        raise UnknownTypeError(_not_found(ros_type, f"its type description is not as expected: {error!r}")) from error
    parts = [_read(ros_type, "msg", places)]
    for name in nested:
        package, short = _split(name)
        parts.append(f"{_SEPARATOR}\nMSG: {package}/{short}\n{_read(name, 'msg', places)}")
    return MessageSchema(ros_type, "\n".join(parts), type_hash)


def _description(ros_type: str, prefixes: Sequence[Path]) -> dict[str, Any]:
    try:
        description = json.loads(_read(ros_type, "json", prefixes))
    except ValueError as error:
        raise UnknownTypeError(_not_found(ros_type, f"its type description is no JSON: {error}")) from error
    if not isinstance(description, dict):
        raise UnknownTypeError(_not_found(ros_type, "its type description is no JSON object"))
    return description


def _read(ros_type: str, suffix: str, prefixes: Sequence[Path]) -> str:
    package, short = _split(ros_type)
    for prefix in prefixes:
        path = prefix / "share" / package / "msg" / f"{short}.{suffix}"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise UnknownTypeError(
        _not_found(ros_type, f"no share/{package}/msg/{short}.{suffix} under {os.pathsep.join(map(str, prefixes))}")
    )


def _split(ros_type: str) -> tuple[str, str]:
    match = _TYPE_NAME.fullmatch(ros_type)
    if match is None:
        raise UnknownTypeError(f"{show(ros_type)} is not the full name of a message type, such as std_msgs/msg/Header")
    return match[1], match[2]


def _not_found(ros_type: str, problem: str) -> str:
    package = ros_type.partition("/")[0]
    return f"message type {ros_type}: {problem}; build or install the package {package} and source its workspace"
