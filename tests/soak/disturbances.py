"""What is done to a fleet in real time, as hypothesis draws it; a fleet can recover from all of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from hypothesis import strategies as st
from tests.soak.scenarios import Draw
from tests.virtual_fleet import Network, VirtualFleet

from swarmabs_config.graph import CONTROLLER, OBSERVER, agent_name
from swarmabs_core.messages import Messages
from swarmabs_core.realtime.agent import RealtimeAgent
from swarmabs_core.realtime.base import RealtimeBehaviour
from swarmabs_core.realtime.controller import RealtimeController

UNTIL = 18.0
"""Time, s, at which everything is over."""
LONGEST_OUTAGE = 1.0
"""Time, s, for which all robots may have to stand still: a plane falls meanwhile."""
CLOCKS = ("clock of a robot", "clock of a coordinator")
KINDS = (
    "bad network",
    "partition",
    "robot dies and comes back",
    "coordinator dies and comes back",
    *CLOCKS,
    "stop and reset",
    "leave and join",
    "robot that stays away",
)


class Disturbance(NamedTuple):
    """Something that is done to a fleet at a time, s; `kind` is None for its end."""

    time: float
    kind: str | None
    do: Callable[[VirtualFleet], None]


@st.composite
def disturbances(draw: Draw, ids: Sequence[int]) -> list[Disturbance]:
    """Draw what is done to these robots, by time; afterwards all but at most one are there and nothing is wrong."""
    found: list[Disturbance] = []
    for kind in draw(st.lists(st.sampled_from(KINDS), min_size=2, max_size=5, unique=True)):
        begin, length = draw(st.floats(1.0, UNTIL - 3.0)), draw(st.floats(0.05, 3.0))
        found.extend(_DRAWN[kind](draw, list(ids), kind, begin, length))
    return sorted(found, key=lambda disturbance: disturbance.time)


def _pair(
    kind: str, begin: float, end: float, do: Callable[[VirtualFleet], None], undo: Callable[[VirtualFleet], None]
) -> list[Disturbance]:
    return [Disturbance(begin, kind, do), Disturbance(end, None, undo)]


def _bad_network(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    worst = {"delay": 0.02, "jitter": 0.03, "loss": 0.1, "duplication": 0.5, "fading": 0.3}
    drawn = {name: draw(st.floats(0.0, largest)) for name, largest in worst.items()}
    bad = Network(**drawn)

    def do(fleet: VirtualFleet) -> None:
        fleet.network = replace(bad, cut=fleet.network.cut)

    def undo(fleet: VirtualFleet) -> None:
        fleet.network = Network(cut=fleet.network.cut)

    return _pair(kind, begin, begin + length, do, undo)


def _partition(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    cut = {agent_name(i) for i in draw(st.lists(st.sampled_from(ids), min_size=1, max_size=len(ids) // 2, unique=True))}

    def do(fleet: VirtualFleet) -> None:
        fleet.network.cut = fleet.network.cut | cut

    def undo(fleet: VirtualFleet) -> None:
        fleet.network.cut = fleet.network.cut - cut

    return _pair(kind, begin, begin + length, do, undo)


def _death(name: str, kind: str, begin: float, length: float) -> list[Disturbance]:
    return _pair(kind, begin, begin + length, lambda fleet: fleet.kill(name), lambda fleet: fleet.revive(name))


def _robot_death(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    return _death(agent_name(draw(st.sampled_from(ids))), kind, begin, length)


def _coordinator_death(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    # A simulated plane that begins anew is at its initial angle: then it is not the same plane.
    return _death(draw(st.sampled_from((OBSERVER, CONTROLLER))), kind, begin, min(length, LONGEST_OUTAGE))


def _clock(draw: Draw, names: tuple[str, ...], kind: str, begin: float, length: float) -> list[Disturbance]:
    name, offset = draw(st.sampled_from(names)), draw(st.floats(-5.0, 5.0) | st.floats(-1e6, 1e6))
    return _pair(
        kind,
        begin,
        begin + length,
        lambda fleet: fleet.set_clock(name, offset),
        lambda fleet: fleet.set_clock(name, 0.0),
    )


def _robot_clock(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    return _clock(draw, tuple(map(agent_name, ids)), kind, begin, length)


def _coordinator_clock(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    return _clock(draw, (OBSERVER, CONTROLLER), kind, begin, min(length, LONGEST_OUTAGE))


def _if_alive(name: str, action: Callable[[RealtimeBehaviour, int], Messages]) -> Callable[[VirtualFleet], None]:
    def do(fleet: VirtualFleet) -> None:
        if fleet.alive(name):
            fleet.call(name, action)

    return do


def _stop_and_reset(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    def stop(node: RealtimeBehaviour, now: int) -> Messages:
        assert isinstance(node, RealtimeController)
        return node.stop(now)

    def reset(node: RealtimeBehaviour, now: int) -> Messages:
        assert isinstance(node, RealtimeController)
        return node.reset(now)

    end = begin + min(length, LONGEST_OUTAGE)
    # Who was away when the reset was told is told again, as an operator would that sees somebody stand still.
    again = Disturbance(UNTIL, None, _if_alive(CONTROLLER, reset))
    return [*_pair(kind, begin, end, _if_alive(CONTROLLER, stop), _if_alive(CONTROLLER, reset)), again]


def _leave_and_join(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    name = agent_name(draw(st.sampled_from(ids)))

    def leave(node: RealtimeBehaviour, now: int) -> Messages:
        assert isinstance(node, RealtimeAgent)
        return node.leave(now)

    def join(node: RealtimeBehaviour, now: int) -> Messages:
        assert isinstance(node, RealtimeAgent)
        return node.join(now)

    return _pair(kind, begin, begin + length, _if_alive(name, leave), _if_alive(name, join))


def _stays_away(draw: Draw, ids: list[int], kind: str, begin: float, length: float) -> list[Disturbance]:
    name = agent_name(draw(st.sampled_from(ids)))
    return [Disturbance(begin, kind, lambda fleet: fleet.kill(name))]


_DRAWN = dict(
    zip(
        KINDS,
        (
            _bad_network,
            _partition,
            _robot_death,
            _coordinator_death,
            _robot_clock,
            _coordinator_clock,
            _stop_and_reset,
            _leave_and_join,
            _stays_away,
        ),
        strict=True,
    )
)
