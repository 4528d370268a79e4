"""What the coordinators of a run in lockstep do if they have standbys: who leads, stands by or is lost, and since when.

Nothing of it is recorded, because it depends on timing and changes no message. A file in the run's logs tells it.
"""

from __future__ import annotations

import json
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_config.files import write_whole
from swarmabs_config.graph import RECORDER, standby_name
from swarmabs_core.pair_role import RECORDS, PairRole

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping
    from pathlib import Path

ROLES_FILE = "roles.json"
LEADS, STANDS_BY = PairRole.LEADING.value, PairRole.FOLLOWING.value
SILENT, LOST = "is silent", "is lost"
_MOST_CHANGES = 100
"""Number of changes that are kept."""


class Role(NamedTuple):
    """What a node does from a step on, and why."""

    step: int
    node: str
    role: str
    why: str = ""

    @property
    def text(self) -> str:
        """One readable line."""
        return f"{self.node} {self.role} from step {self.step}{f': {self.why}' if self.why else ''}"

    @property
    def is_news(self) -> bool:
        """Whether it is a takeover or a loss, from which the other changes follow."""
        return self.role in {LEADS, LOST} and self.step > 0


class Roles:
    """Keeps the roles of a run's pairs; `pairs` gives the other one of each node of a pair.

    Attributes
    ----------
    now : dict
        The present role of each node.
    changes : deque of Role
        The latest changes since the start.
    """

    def __init__(self, pairs: Mapping[str, str]) -> None:
        self._pairs = pairs
        self._first = [Role(0, node, _first_role(node, pairs)) for node in pairs]
        self.now = {role.node: role.role for role in self._first}
        self.changes = deque[Role](maxlen=_MOST_CHANGES)

    @property
    def all(self) -> list[Role]:
        """The roles at the start, and the changes."""
        return [*self._first, *self.changes]

    def lead(self, node: str, step: int, why: str, *, peer: str) -> Iterable[Role]:
        """Note that a node leads from a step on, and the role of its peer, unless that is lost; return the changes."""
        other = self._pairs[node]
        yield from self._change(Role(step, node, LEADS, why))
        if self.now[other] != LOST:
            yield from self._change(Role(step, other, peer))

    def lose(self, node: str, step: int, why: str) -> Iterable[Role]:
        """Note that a node is lost from a step on; return the change."""
        yield from self._change(Role(step, node, LOST, why))

    def _change(self, role: Role) -> Iterable[Role]:
        if self.now[role.node] != role.role:
            self.now[role.node] = role.role
            self.changes.append(role)
            yield role


def _first_role(node: str, pairs: Mapping[str, str]) -> str:
    if node in {RECORDER, standby_name(RECORDER)}:
        return RECORDS
    return LEADS if pairs[node] == standby_name(node) else STANDS_BY


def roles_at(roles: Iterable[Role], step: int) -> tuple[Role, ...]:
    """Return the role of every node at a step."""
    return tuple({role.node: role for role in roles if role.step <= step}.values())


def write_roles(logs: Path, roles: Collection[Role]) -> None:
    """Write the roles next to the logs of a run; the file is replaced, so that readers never see a part of it."""
    write_whole(logs / ROLES_FILE, f"{json.dumps([role._asdict() for role in roles])}\n".encode())


def read_roles(logs: Path) -> list[Role]:
    """Return the roles of a run; none if it has no standbys, or the file is not one."""
    try:
        return [Role(**each) for each in json.loads((logs / ROLES_FILE).read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError):
        return []
