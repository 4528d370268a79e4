"""Seeded schedules against pairs of coordinators: no robot stops for long, and the plane does not notice."""

from collections.abc import Callable
from functools import cache, partial
from random import Random
from typing import NamedTuple

import pytest
from tests.swarmabs_core.helpers import builtin
from tests.virtual.fleet import EPOCH, VirtualFleet

from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.run.realtime_gatherer import RealtimeCollector
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_config.graph import CONTROLLER, OBSERVER, STANDBY_SUFFIX, standby_name, standby_topic
from swarmabs_core.messages import (
    NEVER,
    AbstractState,
    AgentState,
    Broadcast,
    DesiredAbstractState,
    EventKind,
    Message,
    Mode,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.record import Record

BEGIN, CALM = 1.5, 1.5
"""Time, s, before the first fault, and after the end of the last one."""
LONGEST_STOP, LARGEST_ERROR = 0.2, 0.02
"""Time, s, and angle, rad, that a single fault may cost."""
PRIMARIES = (OBSERVER, CONTROLLER)
STANDBYS = (standby_name(OBSERVER), standby_name(CONTROLLER))
TARGETS = (*((name,) for name in (*PRIMARIES, *STANDBYS)), PRIMARIES, STANDBYS)


class Trouble(NamedTuple):
    kind: str
    of: tuple[str, ...]
    lasting: float
    by: float = 0.0


def drawn(seed: int) -> Trouble:
    draw = Random(f"standby:{seed}")
    kind = draw.choice(("kill", "pause", "cut", "delay", "clock"))
    lasting = draw.choice((draw.uniform(0.01, 0.12), draw.uniform(0.1, 1.5)))
    by = draw.uniform(0.01, 0.3) if kind == "delay" else draw.choice((-1, 1)) * draw.uniform(0.001, 0.2)
    return Trouble(kind, draw.choice(TARGETS), lasting, by)


def trouble(fleet: VirtualFleet, what: Trouble) -> None:
    """Let something happen to nodes, and end."""
    network = fleet.network
    for name in what.of:
        if what.kind == "kill":
            fleet.kill(name)
        elif what.kind == "pause":
            fleet.pause(name)
        elif what.kind == "cut":
            network.cut.add(name)
        elif what.kind == "delay":
            network.slow[name] = what.by
        else:
            fleet.set_clock(name, what.by)
    fleet.run(what.lasting)
    for name in what.of:
        if what.kind == "kill":
            fleet.revive(name)
        elif what.kind == "pause":
            fleet.resume(name)
        elif what.kind == "clock":
            fleet.set_clock(name, 0.0)
    network.cut.clear()
    network.slow.clear()


def ran(story: Callable[[VirtualFleet], None], seed: int = 1) -> VirtualFleet:
    fleet = VirtualFleet(builtin("pd_het_4"), paired=True, seed=seed)
    fleet.run(BEGIN)
    story(fleet)
    return fleet


def longest_stop(fleet: VirtualFleet, since: float) -> int:
    """Return the largest number of steps in a row in which a robot was in a safe stop."""
    longest, current = 0, dict.fromkeys(fleet.drives, 0)
    for time, _, message in fleet.published:
        if isinstance(message, AgentState) and time > since * 1e9:
            stopped = message.status == Status.SAFE_STOP
            current[message.agent_id] = current[message.agent_id] + 1 if stopped else 0
            longest = max(longest, current[message.agent_id])
    return longest


def angles(fleet: VirtualFleet) -> dict[int, float]:
    return {m.step: m.angle for _, _, m in fleet.published if isinstance(m, PlaneState)}


@cache
def undisturbed(seconds: int) -> dict[int, float]:
    return angles(ran(lambda fleet: fleet.run(seconds)))


def speakers(fleet: VirtualFleet, kind: type[Message], steps: int = 20) -> set[str]:
    last = fleet.time - steps * 0.01
    return {name for time, name, m in fleet.published if isinstance(m, kind) and time > last * 1e9}


def verified(fleet: VirtualFleet) -> None:
    """Check that all follows from what it is said to follow from, so that no robot has mixed two coordinators."""
    scenario = builtin("pd_het_4")
    clock = configure.schedule(scenario, EPOCH)
    collector = RealtimeCollector(members(scenario), clock)
    verification = RealtimeVerification(scenario, RealtimeWorld(clock, members(scenario), plane=True))
    for time, name, message in fleet.published:
        record, now = Record.of(message), EPOCH + time + 400_000
        if name.endswith(STANDBY_SUFFIX):
            record = record._replace(topic=standby_topic(record.topic))
        for kept in collector.add(record, now):
            verification.add(kept.topic, now, kept.payload, max(0, kept.message.stamp))
    verification.finish()
    assert verification.result.difference is None


def test_a_robot_that_mixes_two_observers_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def mixed(inbox: BroadcastInbox) -> Broadcast | None:
        own, other = (
            inbox._sets.get(inbox.followed._replace(observer=observer))  # noqa: SLF001 - what it holds is to be mixed
            for observer in (inbox.followed.observer, not inbox.followed.observer)
        )
        return own if own is None or other is None else own._replace(auxiliary=other.auxiliary)

    late = Trouble("delay", (OBSERVER,), 0.5, 0.06)
    verified(ran(partial(trouble, what=late)))
    monkeypatch.setattr(BroadcastInbox, "newest", property(mixed))
    with pytest.raises(AssertionError):
        verified(ran(partial(trouble, what=late)))


def check(seed: int) -> None:
    what = drawn(seed)
    fleet = ran(partial(trouble, what=what), seed)
    fleet.run(CALM)
    where = f"seed {seed}: {what}"
    assert longest_stop(fleet, BEGIN) * 0.01 <= LONGEST_STOP, where
    expected, actual = undisturbed(5), angles(fleet)
    error = max(abs(actual[k] - expected[k]) for k in actual)
    assert error <= LARGEST_ERROR, (where, error)
    for kind in (AbstractState, DesiredAbstractState):
        assert len(speakers(fleet, kind)) == 1, where
    verified(fleet)


@pytest.mark.parametrize("seed", range(2))
def test_one_fault(seed: int) -> None:
    check(seed)


@pytest.mark.full
@pytest.mark.timeout(900)
@pytest.mark.parametrize("first", range(0, 300, 50))
def test_one_fault_many_times(first: int) -> None:
    for seed in range(first, first + 50):
        check(seed)


def test_stop_and_reset_hold_through_takeovers() -> None:
    fleet = ran(lambda fleet: fleet.call(STANDBYS[1], "stop"))
    fleet.run(0.3)
    fleet.kill(CONTROLLER)
    fleet.run(0.3)
    fleet.revive(CONTROLLER)
    fleet.run(1.5)
    begin = round((BEGIN + 0.03) * 1e9)
    states = [m for time, _, m in fleet.published if isinstance(m, AgentState) and time > begin]
    assert {m.broadcast_step for m in states} == {NEVER}, "nothing moves until a reset, whoever leads"
    for name in (STANDBYS[1], CONTROLLER):
        fleet.call(name, "reset")
    fleet.run(0.5)
    fleet.kill(STANDBYS[1])
    fleet.run(1.5)
    assert longest_stop(fleet, fleet.time - 0.3) == 0
    assert speakers(fleet, DesiredAbstractState) == {CONTROLLER}
    verified(fleet)


def test_a_planned_takeover() -> None:
    def story(fleet: VirtualFleet) -> None:
        for name in PRIMARIES:
            fleet.call(name, "release")
        fleet.run(0.5)

    fleet = ran(story)
    assert longest_stop(fleet, BEGIN) == 0
    assert speakers(fleet, AbstractState) | speakers(fleet, DesiredAbstractState) == {*STANDBYS}
    leading = [m.detail for _, _, m in fleet.published if isinstance(m, SwarmEvent) and m.kind == EventKind.LEADING]
    assert leading[2:] == [f"{name}: peer silent" for name in STANDBYS]


def test_a_controller_that_starts_before_it_hears_the_other_one_stops_nobody() -> None:
    fleet = VirtualFleet(builtin("pd_het_4"), paired=True, start_mode=Mode.STOP)
    fleet.run(BEGIN)
    assert not speakers(fleet, DesiredAbstractState, 100)
    both = (CONTROLLER, STANDBYS[1])
    for name in both:
        fleet.call(name, "reset")
    fleet.run(BEGIN)
    begin = fleet.time
    for name in both:
        fleet.kill(name)
        fleet.network.cut.add(name)
        fleet.revive(name)
        fleet.run(2.5)
        fleet.network.cut.clear()
        fleet.run(CALM)
        assert len(speakers(fleet, DesiredAbstractState)) == 1
    assert longest_stop(fleet, begin) == 0
    verified(fleet)
