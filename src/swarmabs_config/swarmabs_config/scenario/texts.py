"""Texts of files that end up in names, paths and scripts: a few letters, and never anything a shell reads."""

import re
from typing import Annotated, Any, TypeAlias

from pydantic import AfterValidator

from .errors import show
from .fields import problem

WORD = r"[A-Za-z_][A-Za-z0-9_]*"


def matching(pattern: str, what: str, remedy: str, longest: int = 255) -> AfterValidator:
    """Return a validator of texts that match a pattern as a whole; errors say `what` a text is not, and the remedy."""
    expression = re.compile(pattern)

    def check(text: str) -> str:
        if not expression.fullmatch(text) or len(text) > longest:
            raise problem(f"{show(text)} is no {what}", remedy)
        return text

    return AfterValidator(check)


TopicName: TypeAlias = Annotated[
    str, matching(rf"(/?{WORD}(/{WORD})*)?", "name of a topic", "write e.g. /odom; letters, digits, _ and /")
]
"""A topic, or nothing for one below the node's own name."""
FrameName: TypeAlias = Annotated[
    str, matching(r"[A-Za-z0-9_./-]*", "name of a frame or joint", "use letters, digits, '_', '.', '-' and '/'")
]

LONGEST = 32
"""Of names of fleets and hosts, which become parts of names of units and folders."""
Name: TypeAlias = Annotated[
    str,
    matching(
        r"[A-Za-z0-9][A-Za-z0-9_-]*",
        "name for folders and units",
        f"use 1 to {LONGEST} letters, digits, - and _, first a letter or a digit",
        LONGEST,
    ),
]
"""A fleet or a host."""

TEXTS: dict[str, Any] = {"name": Name, "topic": TopicName, "frame": FrameName}
"""Type of a setting by what its text names."""
