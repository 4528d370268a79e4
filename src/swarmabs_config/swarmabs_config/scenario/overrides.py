"""Overrides from the command line, ``a.b=v``, applied to the tree of a scenario before it is checked."""

import json
from collections.abc import Mapping, Sequence
from functools import partial

from swarmabs_config.model.controllers import DEFAULT_CONTROLLER, DEFAULT_LAW, DEFAULT_TRAJECTORY
from swarmabs_config.model.errors import describe, shorten
from swarmabs_config.model.fields import Location
from swarmabs_config.model.scenario import DEFAULT_OBSERVER, PlaneScenario

from .yaml_tree import Entry, Mark, Node, read_tree

_LONGEST_SHOWN = 100
_TYPED = {
    ("controller",): DEFAULT_CONTROLLER,
    ("controller", "trajectory"): DEFAULT_TRAJECTORY,
    ("swarm", "law"): DEFAULT_LAW,
    ("observer",): DEFAULT_OBSERVER,
}
"""The mappings whose keys depend on their ``type``, with the type they have when it is left out."""


def apply_overrides(root: Node, overrides: Sequence[str]) -> Node:
    """Return the tree with all overrides ``path=value`` applied in order.

    The path is dotted, with list elements by index (the index after the last element appends); the value is YAML.
    Missing mappings on the path are created, and so are lists that have a default. An override that changes the type of
    a controller, a trajectory, a law or the observer drops the file's other keys of that mapping, because they belong
    to the old type; keys set by overrides stay.

    Raises
    ------
    ScenarioError
        If an override cannot be read or its path does not fit the tree; its source is the override itself.
    """
    for text in overrides:
        root = _apply(root, text)
    return root


def _apply(root: Node, text: str) -> Node:
    mark = Mark(f"--set {shorten(text, _LONGEST_SHOWN)}", None)
    path, equals, value = text.partition("=")
    parts = path.strip().split(".")
    if not equals or not all(parts):
        raise mark.error("not of the form path=value", "write e.g. --set plane.angle=0.2")
    if len(parts) > 32:
        raise mark.error(f"the path has {len(parts)} parts", "write e.g. --set plane.angle=0.2")
    new = read_tree(value, mark.source, numbered=False)
    for typed, default in _TYPED.items():
        if parts == [*typed, "type"]:
            root = root.changed(typed, partial(_without_other_type, default=default, new=new))
    return _set(root, (), parts, new, root)


def _set(node: Node, done: Location, parts: Sequence[str], new: Node, root: Node) -> Node:
    """Return `node`, which is at `done` in `root`, with `new` at the path `parts` below it."""
    if not parts:
        return new
    mark, head, rest = new.mark, parts[0], parts[1:]
    if isinstance(node.value, tuple):
        index = _index(node.value, done, head, mark)
        items = list(node.value)
        child = items[index] if index < len(items) else Node({}, mark)
        items[index : index + 1] = [_set(child, (*done, index), rest, new, root)]
        return Node(tuple(items), node.mark)
    if node.value is not None and not isinstance(node.value, Mapping):
        raise mark.error(f"it is {describe(node.value)} and has no parts", "set the whole value", done)
    entries = dict(node.value or {})
    if head in entries and entries[head].node.value is not None:
        child, key = entries[head].node, entries[head].mark
    else:
        child, key = _missing(root, (*done, head), rest, mark), mark
    entries[head] = Entry(key if rest else mark, _set(child, (*done, head), rest, new, root))
    return Node(entries, node.mark)


def _index(items: Sequence[Node], done: Location, head: str, mark: Mark) -> int:
    if not (head.isascii() and head.isdigit()) or len(head) > 9 or int(head) > len(items):
        raise mark.error(
            f"'{shorten(head)}' is not an index of this list of {len(items)}",
            f"use 0 to {len(items) - 1}, or {len(items)} to append" if items else "use 0 to append",
            done,
        )
    return int(head)


def _missing(root: Node, done: Location, rest: Sequence[str], mark: Mark) -> Node:
    """Return the node for a value that the file leaves out: its default, if one of its elements is set."""
    if not rest or not (rest[0].isascii() and rest[0].isdigit()):
        return Node({}, mark)
    default = _default(root, done)
    if isinstance(default, list):
        return read_tree(json.dumps(default), mark.source, numbered=False)
    if done == ("swarm", "agents"):
        raise mark.error("the robots are generated, not listed", "list them, or set keys of swarm.generate", done)
    raise mark.error("it is not a list", "set one of its keys, or the whole value", done)


def _default(root: Node, location: Location) -> object:
    """Return the default of a field, given the types that the tree names."""
    tree = root.plain()
    swarm: dict[str, object] = {"generate": {"single_integrator": 2}}
    data: dict[str, object] = {"schema": 1, "swarm": swarm}
    given = tree if isinstance(tree, dict) else {}
    given_swarm = given.get("swarm")
    laws = given_swarm.get("law") if isinstance(given_swarm, dict) else None
    for key, named, target in (("controller", given.get("controller"), data), ("law", laws, swarm)):
        if isinstance(named, dict) and "type" in named:
            target[key] = {"type": named["type"]}
    try:
        default: object = PlaneScenario.model_validate(data).model_dump(mode="json", by_alias=True)
    except ValueError:  # unknown type of controller: reported when the scenario is checked
        return None
    for part in location:
        default = default.get(str(part)) if isinstance(default, dict) else None
    return default


def _without_other_type(node: Node, default: str, new: Node) -> Node:
    """Return a mapping without the file's keys if its type changes to `new`."""
    if not isinstance(node.value, Mapping):
        return node
    if new.value == (node.entries["type"].node.value if "type" in node.entries else default):
        return node
    return Node({key: entry for key, entry in node.entries.items() if entry.mark.line is None}, node.mark)
