"""YAML as a tree that records the position of every key and value; nothing is executed and nothing guessed.

Only plain data is read: mappings with text keys, lists, and scalars of the YAML 1.2 core schema. So ``1e-3`` is a
number, and ``yes`` and ``1:30`` are texts. Values that YAML versions read differently (``010``) and numbers that are
not finite (``.nan``) are rejected. Size, depth and the number of values after expansion of aliases are limited.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn, TypeAlias

import yaml

from swarmabs_config.model.errors import ScenarioError, describe, show
from swarmabs_config.model.fields import Location

LARGEST_TEXT = 16 * 2**20
"""Largest text in bytes; 65,535 listed robots, the most there can be, fit."""
MOST_VALUES = 2_000_000
"""Maximum number of values and keys, with aliases expanded."""
DEEPEST = 32
"""Deepest nesting of lists and mappings."""

# Only the events of these loaders are used, never the objects they construct. libyaml's is ten times faster.
LOADER: "Loader" = yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader

_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_LEADING_ZERO = re.compile(r"[-+]?0[0-9]+")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_UNPRINTABLE = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_LONGEST_NUMBER = 400
_CONSTANTS: dict[str, bool | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_TAG = "tag:yaml.org,2002:"
_REMOVE_TAG = "remove the tag: a scenario is plain data"

Loader: TypeAlias = "type[yaml.CSafeLoader | yaml.SafeLoader]"
Scalar: TypeAlias = str | int | float | bool | None
Plain: TypeAlias = "Scalar | list[Plain] | dict[str, Plain]"


@dataclass(frozen=True, slots=True)
class Mark:
    """A position: a file with a line counted from 1, or an override."""

    source: str
    line: int | None

    def error(self, problem: str, remedy: str, field: Location = ()) -> ScenarioError:
        """Return an error at this position."""
        return ScenarioError(self.source, problem, remedy, line=self.line, field=dotted(field))


@dataclass(frozen=True, slots=True)
class Node:
    """A value with its position; `size` and `height` are those after expansion of aliases."""

    value: "Scalar | tuple[Node, ...] | Mapping[str, Entry]"
    mark: Mark
    size: int = 1
    height: int = 0

    def plain(self) -> Plain:
        """Return the value without positions."""
        if isinstance(self.value, Mapping):
            return {key: entry.node.plain() for key, entry in self.value.items()}
        if isinstance(self.value, tuple):
            return [node.plain() for node in self.value]
        return self.value

    def locate(self, location: Location) -> tuple[Mark, bool]:
        """Return the position of a field and True, or that of its nearest parent and False.

        The position of a mapping or a list is that of its key, of a scalar its own, and of a value that an override has
        changed, even in part, the override.
        """
        node, mark = self, self.mark
        for part in location:
            if isinstance(node.value, Mapping) and str(part) in node.value:
                entry = node.value[str(part)]
                node = entry.node
                mark = entry.mark if isinstance(node.value, Mapping | tuple) else node.mark
            elif isinstance(node.value, tuple) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
                mark = node.mark
            else:
                return mark, False
        return node.override() or mark, True

    @property
    def entries(self) -> "Mapping[str, Entry]":
        """The entries of a mapping; none for any other value."""
        return self.value if isinstance(self.value, Mapping) else {}

    def changed(self, path: Sequence[str], change: "Callable[[Node], Node]") -> "Node":
        """Return the tree with the node at a path of keys changed; the same tree if there is none."""
        if not path:
            return change(self)
        if path[0] not in self.entries:
            return self
        entry = self.entries[path[0]]
        below = Entry(entry.mark, entry.node.changed(path[1:], change))
        return Node({**self.entries, path[0]: below}, self.mark)

    def override(self) -> Mark | None:
        """Return the position of the last override in this value; overrides have no line."""
        parts = self.value if isinstance(self.value, tuple) else [entry.node for entry in self.entries.values()]
        last = self.mark if self.mark.line is None else None
        for part in parts:
            last = part.override() or last
        return last


@dataclass(frozen=True, slots=True)
class Entry:
    """A value of a mapping with the position of its key."""

    mark: Mark
    node: Node


def dotted(location: Location) -> str:
    """Return a field's path as in ``--set``."""
    return ".".join(str(part) for part in location)


def read_tree(text: str, source: str, *, numbered: bool = True, loader: "Loader" = LOADER) -> Node:
    """Read one YAML document; an empty one is null. Positions have line numbers if `numbered`.

    The `loader` provides the events.

    Raises
    ------
    ScenarioError
        If the text is not YAML, not plain data, or too large.
    """
    return _Reader(text, source, loader, numbered=numbered).read()


class _Reader:
    """Turns the events of one document into a tree."""

    def __init__(self, text: str, source: str, loader: "Loader", *, numbered: bool) -> None:
        self._text = text
        self._loader = loader
        self._source = source
        self._numbered = numbered
        self._values = 0
        self._anchors: dict[str, Node] = {}
        self._path: list[str | int] = []
        self._events: Iterator[yaml.Event] = iter(())

    def read(self) -> Node:
        if len(self._text) > LARGEST_TEXT:
            raise self._mark(None).error(
                f"more than {LARGEST_TEXT} characters", "shorten it; 'swarm.generate' describes many robots"
            )
        if bad := _UNPRINTABLE.search(self._text):
            line = self._text.count("\n", 0, bad.start())
            raise self._mark(line).error(f"the character {bad.group()!a} is not allowed in a text", "remove it")
        self._events = yaml.parse(self._text, Loader=self._loader)
        try:
            return self._document()
        except yaml.YAMLError as exc:
            text, mark = str(exc), None
            if isinstance(exc, yaml.MarkedYAMLError):
                text = ", ".join(part for part in (exc.context, exc.problem) if part)
                mark = exc.problem_mark or exc.context_mark
            column = f" near column {mark.column + 1}" if mark else ""
            raise self._mark(mark.line if mark else None).error(
                f"not valid YAML: {text}", f"check indentation, brackets and quotes{column}"
            ) from exc

    def _document(self) -> Node:
        root = Node(None, self._mark(0))
        documents = 0
        for event in self._events:
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    raise self._at(event).error("a second YAML document", "keep one scenario per file, without '---'")
                root = self._node(next(self._events), 0)
        return root

    def _node(self, event: yaml.Event, depth: int) -> Node:
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, depth)
        self._count(event, 1)
        if isinstance(event, yaml.ScalarEvent):
            node = Node(self._scalar(event), self._at(event))
        elif depth >= DEEPEST:
            self._fail(event, f"nested more than {DEEPEST} deep", "flatten it")
        elif isinstance(event, yaml.SequenceStartEvent):
            node = self._sequence(event, depth + 1)
        else:
            node = self._mapping(event, depth + 1)
        if isinstance(event, yaml.NodeEvent) and event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _alias(self, event: yaml.AliasEvent, depth: int) -> Node:
        node = self._anchors.get(event.anchor or "")
        if node is None:
            self._fail(event, f"the alias {show(event.anchor)} has no anchor before it", "write the value itself")
        self._count(event, node.size)
        if depth + node.height > DEEPEST:
            self._fail(event, f"nested more than {DEEPEST} deep", "flatten it")
        return node

    def _sequence(self, event: yaml.SequenceStartEvent, depth: int) -> Node:
        self._require_tag(event, "seq")
        items: list[Node] = []
        while not isinstance(event_ := next(self._events), yaml.SequenceEndEvent):
            self._path.append(len(items))
            items.append(self._node(event_, depth))
            self._path.pop()
        height = 1 + max((node.height for node in items), default=0)
        return Node(tuple(items), self._at(event), 1 + sum(node.size for node in items), height)

    def _mapping(self, event: yaml.Event, depth: int) -> Node:
        self._require_tag(event, "map")
        entries: dict[str, Entry] = {}
        while not isinstance(event_ := next(self._events), yaml.MappingEndEvent):
            mark = self._at(event_)
            key = self._key(event_)
            self._path.append(key)
            if key in entries:
                first = entries[key].mark.line
                seen = f" (see line {first})" if first else ""
                raise mark.error(f"the key is given twice{seen}", "remove one of them", tuple(self._path))
            entries[key] = Entry(mark, self._node(next(self._events), depth))
            self._path.pop()
        height = 1 + max((entry.node.height for entry in entries.values()), default=0)
        size = 1 + sum(1 + entry.node.size for entry in entries.values())
        return Node(entries, self._at(event), size, height)

    def _key(self, event: yaml.Event) -> str:
        self._count(event, 1)
        if not isinstance(event, yaml.ScalarEvent):
            self._fail(event, "a key that is not a name", "write 'key: value' with a name as key")
        key = self._scalar(event)
        if not isinstance(key, str):
            self._fail(event, f"a key that is not a name: {describe(key)}", "write 'key: value' with a name as key")
        return key

    def _scalar(self, event: yaml.ScalarEvent) -> Scalar:
        tag = event.tag
        if tag in {"!", f"{_TAG}str"} or (tag is None and not event.implicit[0]):
            return event.value
        if tag is None:
            return self._plain(event)
        kinds: dict[str, tuple[type, ...]] = {
            f"{_TAG}int": (int,),
            f"{_TAG}float": (int, float),
            f"{_TAG}bool": (bool,),
            f"{_TAG}null": (type(None),),
        }
        if tag not in kinds:
            self._refuse_tag(event, tag)
        value = self._plain(event)
        if type(value) not in kinds[tag]:
            self._fail(event, f"{describe(value)} does not fit its tag {show(tag)}", _REMOVE_TAG)
        return value

    def _plain(self, event: yaml.ScalarEvent) -> Scalar:
        text = event.value
        if text in _CONSTANTS:
            return _CONSTANTS[text]
        if _LEADING_ZERO.fullmatch(text):
            self._fail(
                event,
                f"{show(text)} begins with 0, which could mean octal",
                "remove the 0, or quote the value to make it a text",
            )
        if _NOT_FINITE.fullmatch(text):
            self._fail(event, f"{text} is not a finite number", "give a finite number")
        if not _FLOAT.fullmatch(text):
            return text
        if len(text) > _LONGEST_NUMBER:
            self._fail(event, f"a number of {len(text)} characters", f"shorten it to at most {_LONGEST_NUMBER}")
        if _INTEGER.fullmatch(text):
            return int(text)
        value = float(text)
        if math.isinf(value):
            self._fail(event, f"{show(text)} is not a finite number", "give a finite number")
        return value

    def _require_tag(self, event: yaml.Event, name: str) -> None:
        tag = getattr(event, "tag", None)
        if tag not in {None, "!", f"{_TAG}{name}"}:
            self._refuse_tag(event, tag)

    def _refuse_tag(self, event: yaml.Event, tag: str) -> NoReturn:
        self._fail(event, f"the tag {show(tag)} is not allowed", _REMOVE_TAG)

    def _count(self, event: yaml.Event, values: int) -> None:
        self._values += values
        if self._values > MOST_VALUES:
            self._fail(
                event,
                f"more than {MOST_VALUES} values after expansion of aliases",
                "write the scenario without aliases",
            )

    def _fail(self, event: yaml.Event, problem: str, remedy: str) -> NoReturn:
        raise self._at(event).error(problem, remedy, tuple(self._path))

    def _at(self, event: yaml.Event) -> Mark:
        return self._mark(event.start_mark.line if event.start_mark else None)

    def _mark(self, line: int | None) -> Mark:
        return Mark(self._source, line + 1 if line is not None and self._numbered else None)
