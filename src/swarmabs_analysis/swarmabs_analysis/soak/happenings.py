"""What happens to a fleet in a soak: drawn from a scenario's seed alone."""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_analysis.soak import draw
from swarmabs_core.realtime.agent import RealtimeAgent
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_run.virtual_fleet import CONTROLLER, OBSERVER, PLANE, Network, agent_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Messages
    from swarmabs_core.realtime.base import RealtimeBehaviour
    from swarmabs_run.virtual_fleet import VirtualFleet

COORDINATORS = (PLANE, OBSERVER, CONTROLLER)
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


class Happening(NamedTuple):
    """Something that is done to a fleet at a time, s; `kind` is None for its end."""

    time: float
    kind: str | None
    do: Callable[[VirtualFleet], None]


def drawn_happenings(scenario: Scenario) -> list[Happening]:
    """Return what happens, by time; afterwards all but at most one robot are there and nothing is wrong any more."""
    random = Random(f"happenings:{scenario.seed}")  # noqa: S311 - no secret
    ids = [agent.id for agent in scenario.agents]
    found: list[Happening] = []
    for kind in random.sample(KINDS, random.randint(2, 5)):
        begin = round(random.uniform(1.0, draw.FAULTS_UNTIL - 3.0), 3)
        length = round(random.uniform(0.05, 3.0), 3)
        found.extend(_DRAWN[kind](random, ids, kind, begin, length))
    return sorted(found, key=lambda happening: happening.time)


def _pair(
    kind: str, begin: float, end: float, do: Callable[[VirtualFleet], None], undo: Callable[[VirtualFleet], None]
) -> list[Happening]:
    return [Happening(begin, kind, do), Happening(end, None, undo)]


def _bad_network(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:  # noqa: ARG001
    bad = Network(
        delay=random.uniform(0.0002, 0.02),
        jitter=random.choice((0.0, random.uniform(0.0, 0.03))),
        loss=random.choice((0.0, random.uniform(0.0, 0.1))),
        duplication=random.choice((0.0, random.uniform(0.0, 0.5))),
        fading=random.choice((0.0, random.uniform(0.0, 0.3))),
    )

    def do(fleet: VirtualFleet) -> None:
        fleet.network = replace(bad, cut=fleet.network.cut)

    def undo(fleet: VirtualFleet) -> None:
        fleet.network = Network(cut=fleet.network.cut)

    return _pair(kind, begin, begin + length, do, undo)


def _partition(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:
    cut = {agent_name(i) for i in random.sample(ids, random.randint(1, len(ids) // 2))}

    def do(fleet: VirtualFleet) -> None:
        fleet.network.cut = fleet.network.cut | cut

    def undo(fleet: VirtualFleet) -> None:
        fleet.network.cut = fleet.network.cut - cut

    return _pair(kind, begin, begin + length, do, undo)


def _death(name: str, kind: str, begin: float, length: float) -> list[Happening]:
    return _pair(kind, begin, begin + length, lambda fleet: fleet.kill(name), lambda fleet: fleet.revive(name))


def _robot_death(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:
    return _death(agent_name(random.choice(ids)), kind, begin, length)


def _coordinator_death(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:  # noqa: ARG001
    # A simulated plane that begins anew is at its initial angle: then it is not the same plane.
    return _death(random.choice((OBSERVER, CONTROLLER)), kind, begin, min(length, LONGEST_OUTAGE))


def _clock(names: tuple[str, ...], random: Random, kind: str, begin: float, length: float) -> list[Happening]:
    name, offset = random.choice(names), random.choice((random.uniform(-5.0, 5.0), random.uniform(-1e6, 1e6)))
    return _pair(
        kind,
        begin,
        begin + length,
        lambda fleet: fleet.set_clock(name, offset),
        lambda fleet: fleet.set_clock(name, 0.0),
    )


def _robot_clock(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:
    return _clock(tuple(map(agent_name, ids)), random, kind, begin, length)


def _coordinator_clock(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:  # noqa: ARG001
    return _clock((OBSERVER, CONTROLLER), random, kind, begin, min(length, LONGEST_OUTAGE))


def _if_alive(name: str, action: Callable[[RealtimeBehaviour, int], Messages]) -> Callable[[VirtualFleet], None]:
    def do(fleet: VirtualFleet) -> None:
        if fleet.alive(name):
            fleet.call(name, action)

    return do


def _stop_and_reset(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:  # noqa: ARG001
    def stop(node: RealtimeBehaviour, now: int) -> Messages:
        assert isinstance(node, RealtimeController)  # noqa: S101 - it is the controller's
        return node.stop(now)

    def reset(node: RealtimeBehaviour, now: int) -> Messages:
        assert isinstance(node, RealtimeController)  # noqa: S101
        return node.reset(now)

    end = begin + min(length, LONGEST_OUTAGE)
    # Who was away when the reset was told is told again, as an operator would that sees somebody stand still.
    again = Happening(draw.FAULTS_UNTIL, None, _if_alive(CONTROLLER, reset))
    return [*_pair(kind, begin, end, _if_alive(CONTROLLER, stop), _if_alive(CONTROLLER, reset)), again]


def _leave_and_join(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:
    name = agent_name(random.choice(ids))

    def leave(node: RealtimeBehaviour, now: int) -> Messages:
        assert isinstance(node, RealtimeAgent)  # noqa: S101 - it is a robot's
        return node.leave(now)

    def join(node: RealtimeBehaviour, now: int) -> Messages:
        assert isinstance(node, RealtimeAgent)  # noqa: S101
        return node.join(now)

    return _pair(kind, begin, begin + length, _if_alive(name, leave), _if_alive(name, join))


def _stays_away(random: Random, ids: list[int], kind: str, begin: float, length: float) -> list[Happening]:  # noqa: ARG001
    name = agent_name(random.choice(ids))
    return [Happening(begin, kind, lambda fleet: fleet.kill(name))]


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
