"""Who leads and who stands by where coordinators have standbys, by the diagnostics of their nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_config.graph import CONTROLLER, OBSERVER, RECORDER, SILENCE, standby_name
from swarmabs_core.pair_role import ROLE, ROLE_FOR
from swarmabs_view.protocol import Coordinator, CoordinatorPair, Coordinators

if TYPE_CHECKING:
    from collections.abc import Mapping

SILENT = "is silent"


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
        pairs = [
            CoordinatorPair(name=name, primary=self._shown(name, now), standby=self._shown(standby_name(name), now))
            for name in (OBSERVER, CONTROLLER, RECORDER)
            if name in self._heard or standby_name(name) in self._heard
        ]
        return Coordinators(pairs=pairs) if pairs else None

    def _shown(self, node: str, now: float) -> Coordinator:
        if node not in self._heard:
            return Coordinator(role=SILENT, seconds=None, ok=False)
        heard = self._heard[node]
        age = now - heard.at
        if age > SILENCE:
            return Coordinator(role=SILENT, seconds=int(age), ok=False)
        return Coordinator(role=heard.role, seconds=int(heard.seconds + age), ok=True)
