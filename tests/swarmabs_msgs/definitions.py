"""The .msg files, read by their text."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "src" / "swarmabs_msgs" / "msg"
FILES = tuple(sorted(FOLDER.glob("*.msg")))

_LINE = re.compile(r"(?P<type>\S+)\s+(?P<name>\w+)\s*(?:=\s*(?P<value>\S+))?\s*(?:#\s*(?P<comment>.*))?$")

SIZES = {"uint8": 1, "uint16": 2, "uint32": 4, "uint64": 8, "float64": 8}


@dataclass(frozen=True)
class Field:
    """A field or, with a value, a constant."""

    type: str
    name: str
    value: int | None
    comment: str


@dataclass(frozen=True)
class Definition:
    """A message definition."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Field, ...]


def read_definition(path: Path) -> Definition:
    """Read a definition; what stands behind an entry, or in the line above it, is its comment."""
    entries = []
    above = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        text = line.strip()
        if not text or text.startswith("#"):
            above = text.removeprefix("#").strip()
            continue
        found = _LINE.match(text)
        assert found is not None, f"{path.name}: {line!r}"
        value = None if found["value"] is None else int(found["value"])
        entries.append(Field(found["type"], found["name"], value, found["comment"] or above))
        above = ""
    return Definition(
        path.stem,
        tuple(entry for entry in entries if entry.value is None),
        tuple(entry for entry in entries if entry.value is not None),
    )


DEFINITIONS = {path.stem: read_definition(path) for path in FILES}


def significant_bytes(definition: Definition, detail: bytes, robots: int = 0) -> list[bool]:
    """Tell of every byte of a message in CDR whether it carries content, by the rules of CDR alone.

    Parameters
    ----------
    definition : Definition
        The message.
    detail : bytes
        Content of its string, where it has one.
    robots : int
        Length of its arrays, where it has some.
    """
    content: list[bool] = []  # the encapsulation apart, from where alignment counts
    _add_message(content, definition, detail, robots)
    # Of the encapsulation's two option bytes the last may say how much padding follows.
    return [True, True, True, False, *content]


def _add_message(content: list[bool], definition: Definition, detail: bytes, robots: int) -> None:
    content += [False] * (-len(content) % 4)
    content += [True] * (4 + 4 + 4 + len("plane") + 1)  # seconds, nanoseconds, length and characters of the frame id
    for field in definition.fields[1:]:
        if field.type in DEFINITIONS:
            _add_message(content, DEFINITIONS[field.type], detail, robots)
        elif field.type == "string":
            content += [False] * (-len(content) % 4) + [True] * (4 + len(detail) + 1)
        elif field.type.endswith("[]"):
            size = SIZES[field.type.removesuffix("[]")]
            content += [False] * (-len(content) % 4) + [True] * 4
            content += [False] * (-len(content) % size if robots else 0) + [True] * (size * robots)
        else:
            size = SIZES[field.type]
            content += [False] * (-len(content) % size) + [True] * size
