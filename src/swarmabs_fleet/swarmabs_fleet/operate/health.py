"""The health of a swarm: what its nodes report of themselves, and which nodes are silent."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.realtime.base import Level

if TYPE_CHECKING:
    from collections.abc import Mapping

SILENT_AFTER = 3.0
"""Time, s, without a word after which a node is not taken to live; it speaks once a second."""
SILENT = "silent"


class Row(NamedTuple):
    """A node: its host, how it is (OK, WARN, ERROR, silent), what it says, and its figures by name."""

    node: str
    host: str
    level: str
    text: str
    values: Mapping[str, str]


@dataclass(slots=True)
class HealthMonitor:
    """Keeps the newest word of every node.

    Parameters
    ----------
    hosts : mapping
        Host by node that there should be.
    """

    hosts: Mapping[str, str]
    _words: dict[str, tuple[float, int, str, dict[str, str]]] = field(default_factory=dict)

    def hear(self, node: str, level: int, text: str, values: Mapping[str, str], now: float) -> None:
        """Note what a node says of itself at a steady time, s."""
        self._words[node] = (now, level, text, dict(values))

    def complete(self) -> bool:
        """Tell whether every node has been heard."""
        return all(node in self._words for node in self.hosts)

    def value(self, node: str, name: str) -> str:
        """Return a figure that a node has told last, empty if it has not."""
        word = self._words.get(node)
        return "" if word is None else word[3].get(name, "")

    def rows(self, now: float) -> list[Row]:
        """Return one row per node that there should be, and behind them those that nobody expects."""
        strangers = sorted(node for node in self._words if node not in self.hosts)
        return [self._row(node, self.hosts.get(node, "unknown"), now) for node in (*self.hosts, *strangers)]

    def _row(self, node: str, host: str, now: float) -> Row:
        word = self._words.get(node)
        if word is None:
            return Row(node, host, SILENT, "has not been heard", {})
        heard, level, text, values = word
        if now - heard > SILENT_AFTER:
            return Row(node, host, SILENT, f"not heard for {now - heard:.0f} s; then: {text}", values)
        names = {int(each): each.name for each in Level}
        return Row(node, host, names.get(level, "STALE"), text, values)


def in_order(rows: list[Row]) -> bool:
    """Tell whether no node is silent or in error."""
    return not any(row.level in (SILENT, Level.ERROR.name, "STALE") for row in rows)
