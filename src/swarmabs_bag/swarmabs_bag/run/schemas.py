"""Schemas of message types as stored in a bag: full definition text and RIHS01 hash of the type.

Both come from the files that rosidl installs with every message package: ``share/PACKAGE/msg/TYPE.msg`` and the type
description ``TYPE.json`` (REP 2011), which also lists every nested type.
"""

from __future__ import annotations

import json
import os
import re
from typing import NamedTuple

from swarmabs_bag.errors import UnknownTypeError
from swarmabs_config.installation import prefixes, shared
from swarmabs_config.model.errors import show

_TYPE_NAME = re.compile(r"([a-z][a-z0-9_]{,99})/msg/([A-Z][A-Za-z0-9]{,99})")
_SEPARATOR = "=" * 80


class MessageSchema(NamedTuple):
    """Definition of a message type: text in the encoding ``ros2msg``, and RIHS01 hash.

    The text is followed by the definitions of all nested types, after separator lines.
    """

    name: str
    text: str
    type_hash: str


def message_schema(ros_type: str) -> MessageSchema:
    """Find the definition of a message type, such as ``sensor_msgs/msg/JointState``, among the installed packages.

    Raises
    ------
    UnknownTypeError
        If the name is not that of a message type, or a definition is not installed.
    """
    try:
        description = json.loads(_read(ros_type, "json"))
        nested = sorted(
            entry["type_name"] for entry in description["type_description_msg"]["referenced_type_descriptions"]
        )
        hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
        type_hash = str(hashes[ros_type])
    except (ValueError, KeyError, TypeError) as error:
        raise _not_found(ros_type, f"its type description is not as expected: {error!r}") from error
    parts = [_read(ros_type, "msg")]
    for name in nested:
        package, short = _split(name)
        parts.append(f"{_SEPARATOR}\nMSG: {package}/{short}\n{_read(name, 'msg')}")
    return MessageSchema(ros_type, "\n".join(parts), type_hash)


def _read(ros_type: str, suffix: str) -> str:
    """Return a file of a type from the first prefix that has it."""
    package, short = _split(ros_type)
    path = shared(package, "msg", f"{short}.{suffix}")
    if path is None:
        places = os.pathsep.join(map(str, prefixes()))
        raise _not_found(ros_type, f"no share/{package}/msg/{short}.{suffix} under {places}")
    return path.read_text(encoding="utf-8")


def _split(ros_type: str) -> tuple[str, str]:
    match = _TYPE_NAME.fullmatch(ros_type)
    if match is None:
        raise UnknownTypeError(f"{show(ros_type)} is not the full name of a message type, such as std_msgs/msg/Header")
    return match[1], match[2]


def _not_found(ros_type: str, problem: str) -> UnknownTypeError:
    package = ros_type.partition("/")[0]
    return UnknownTypeError(
        f"message type {ros_type}: {problem}; build or install the package {package} and source its workspace"
    )
