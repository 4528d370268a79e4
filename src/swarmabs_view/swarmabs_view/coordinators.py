"""Who leads and who stands by where coordinators have standbys: in real time by diagnostics.

Earlier runs in lockstep had standbys, too; a file in their logs tells the roles.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_config.graph import CONTROLLER, OBSERVER, RECORDER, SILENCE, standby_name
from swarmabs_core.events import EventCode
from swarmabs_core.messages import SwarmEvent
from swarmabs_core.pair_role import RECORDS, ROLE, ROLE_FOR, PairRole
from swarmabs_view.protocol import Coordinator, CoordinatorPair, Coordinators

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

ROLES_FILE = "roles.json"
LEADS, SILENT, LOST = PairRole.LEADING.value, "is silent", "is lost"
_STANDBY_RECORDER = standby_name(RECORDER)
_UNHEARD = Coordinator(role=SILENT, seconds=None, ok=False)


class Role(NamedTuple):
    """What a node of a run in lockstep does from a step on, and why."""

    step: int
    node: str
    role: str
    why: str = ""


def _paired(found: Mapping[str, Coordinator]) -> Coordinators | None:
    """Return the message for nodes of pairs, None if there are none."""
    pairs = [
        CoordinatorPair(name=name, primary=found.get(name, _UNHEARD), standby=found.get(standby_name(name), _UNHEARD))
        for name in (OBSERVER, CONTROLLER, RECORDER)
        if name in found or standby_name(name) in found
    ]
    return Coordinators(pairs=pairs) if pairs else None


class _Heard(NamedTuple):
    at: float
    role: str
    seconds: float


class DiagnosedRoles:
    """The roles that the nodes of a swarm in real time publish with their diagnostics."""

    def __init__(self) -> None:
        self._heard: dict[str, _Heard] = {}

    def hear(self, node: str, values: Mapping[str, str], now: float) -> None:
        """Take the values of a node's diagnostics at a time (s); those without a role say nothing."""
        role, seconds = values.get(ROLE, ""), values.get(ROLE_FOR, "")
        if role and seconds.isdecimal():
            self._heard[node] = _Heard(now, role, float(seconds))

    def message(self, now: float) -> Coordinators | None:
        """Return the roles at a time (s), None where no coordinator has a standby."""
        return _paired({node: _shown(heard, now - heard.at) for node, heard in self._heard.items()})


def _shown(heard: _Heard, age: float) -> Coordinator:
    if age > SILENCE:
        return Coordinator(role=SILENT, seconds=int(age), ok=False)
    return Coordinator(role=heard.role, seconds=int(heard.seconds + age), ok=True)


def read_roles(logs: Path) -> list[Role]:
    """Return the roles of a run in lockstep; none if it had no standbys, or the file is not one."""
    try:
        return [Role(**each) for each in json.loads((logs / ROLES_FILE).read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError):
        return []


def _roles_at(roles: Iterable[Role], step: int) -> tuple[Role, ...]:
    """Return the role of every node at a step."""
    return tuple({role.node: role for role in roles if role.step <= step}.values())


def coordinators_at(roles: Sequence[Role], step: int, period: float) -> Coordinators | None:
    """Return the roles of a run in lockstep at a step, given its period (s); None if it has no standbys."""
    return _paired(
        {
            role.node: Coordinator(
                role=role.role,
                seconds=int((step - role.step) * period),
                ok=role.role not in {LOST, SILENT},
            )
            for role in _roles_at(roles, step)
        }
    )


def takeovers(roles: Sequence[Role]) -> list[SwarmEvent]:
    """Return the takeovers of a run in lockstep as the events that coordinators in real time publish.

    Both recorders record, so that of the standby takes over by the loss of the other one.
    """
    now: dict[str, str] = {}
    found = []
    for role in roles:
        now[role.node] = role.role
        if not role.step:  # the roles at the start
            continue
        if role.role == LEADS:
            found.append((role.step, f"{role.node}: {role.why}"))
        elif (role.node, role.role, now.get(_STANDBY_RECORDER)) == (RECORDER, LOST, RECORDS):
            found.append((role.step, f"{_STANDBY_RECORDER}: {RECORDER} {role.why}"))
    return [EventCode.LEADING.event(0, step, detail=detail) for step, detail in found]
