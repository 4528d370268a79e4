"""Two documents of settings side by side: scenarios, or what is said of where bags come from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

_DEEPEST = 32
"""Nesting down to which documents are taken apart; scenarios are never deeper."""


class SettingDifference(NamedTuple):
    """A field with different values in two documents: dotted path, both values, and which document lacks it."""

    field: str
    a: Any
    b: Any
    missing: Literal["A", "B"] | None = None


def setting_differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> tuple[SettingDifference, ...]:
    """Return the fields in which two documents differ, in the order of the first one, then of the second.

    Parameters
    ----------
    a, b : mapping
        Plain data. Paths are those of ``--set``: dotted, the elements of lists of mappings by index; a list of
        plain values is one value, and an empty list is no different from none.
    """
    ours, theirs = dict(_leaves(a, "", 0)), dict(_leaves(b, "", 0))
    changed = [
        SettingDifference(path, value, theirs.get(path), None if path in theirs else "B")
        for path, value in ours.items()
        if path not in theirs or theirs[path] != value
    ]
    added = [SettingDifference(path, None, value, "A") for path, value in theirs.items() if path not in ours]
    return (*changed, *added)


def _leaves(value: Any, path: str, depth: int) -> Iterator[tuple[str, Any]]:
    children: Mapping[Any, Any] = {}
    if isinstance(value, Mapping):
        children = value
    elif isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
        children = dict(enumerate(value))
    if value in ([], {}):
        return
    if not children or depth == _DEEPEST:
        yield path, value
        return
    for key, child in children.items():
        yield from _leaves(child, f"{path}.{key}" if path else str(key), depth + 1)
