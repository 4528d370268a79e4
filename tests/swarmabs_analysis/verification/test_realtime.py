"""Verification of runs in real time: right ones, changed bits, robots that cheat, and what cannot be known."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from tests.swarmabs_core.helpers import builtin
from tests.swarmabs_core.realtime.bags import WORLDS, Recorded, Stored, messages, record, world
from tests.virtual_fleet import EPOCH, VirtualFleet

from swarmabs_analysis.difference import Difference
from swarmabs_analysis.verification.base import Verdict
from swarmabs_analysis.verification.realtime import RealtimeVerification
from swarmabs_bag.realtime import RealtimeWorld
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_config.graph import CONTROLLER
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import encode
from swarmabs_core.messages import (
    AGENT_STATE,
    BASIS,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    MAIN_TOPICS,
    NEVER,
    PLANE_STATE,
    AgentState,
    Basis,
    DesiredAbstractState,
    EventKind,
    Mode,
    PlaneState,
    Source,
    Status,
    SwarmEvent,
)
from swarmabs_core.realtime import agent
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.broadcasts import BroadcastInbox

SIMULATED_BY_THE_WORLD = {"clocks": (2, 3, 4)}
"""Robots whose bodies follow the clock of their node; the virtual bodies follow that of the world."""


def started(scenario: Scenario, schedule: Schedule, *, tolerance: float = 0.0, **differs: Any) -> RealtimeVerification:
    simulated = replace(RealtimeWorld(schedule, members(scenario), plane=True), **differs)
    return RealtimeVerification(scenario, simulated, tolerance=tolerance)


def verify(scenario: Scenario, bag: Iterable[Stored], **options: Any) -> Verdict:
    verification = started(scenario, configure.schedule(scenario, EPOCH), **options)
    for stored in bag:
        verification.add(*stored)
    verification.finish()
    return verification.found


def verified(name: str, **options: float) -> tuple[Recorded, Verdict]:
    recorded = world(name, **options)
    robots = SIMULATED_BY_THE_WORLD.get(name, members(recorded.scenario))
    return recorded, verify(recorded.scenario, recorded.bag, robots=robots)


def of_main_topics(bag: Iterable[Stored]) -> int:
    return sum(stored.topic in MAIN_TOPICS for stored in bag)


@pytest.mark.parametrize("name", WORLDS)
def test_all_of_a_right_run_is_found_right(name: str) -> None:
    recorded, found = verified(name)
    assert found.difference is None
    assert found.messages + found.not_checkable.total() == of_main_topics(recorded.bag)
    # Where a clock is set back, steps come twice, and the bag has the first of each.
    assert found.not_checkable.total() <= (500 if name == "clocks" else 0)


@pytest.mark.parametrize("name", WORLDS)
def test_what_was_lost_or_late_on_the_way_to_the_recorder_is_no_error(name: str) -> None:
    recorded, found = verified(name, loss=0.03, jitter=0.012)
    assert found.difference is None
    assert found.messages + found.not_checkable.total() == of_main_topics(recorded.bag)
    assert 0 < found.not_checkable.total() < 0.5 * found.messages


def test_the_worlds_have_what_they_are_there_for() -> None:
    def seen(name: str) -> set[EventKind]:
        return {EventKind(m.kind) for m in messages(world(name).bag) if isinstance(m, SwarmEvent)}

    def modes(name: str) -> set[int]:
        return {m.mode for m in messages(world(name).bag) if isinstance(m, DesiredAbstractState)}

    def robots(name: str) -> list[AgentState]:
        return [m for m in messages(world(name).bag) if isinstance(m, AgentState)]

    assert {EventKind.DEAD, EventKind.JOINED, EventKind.SAFE_STOP, EventKind.RECOVERED} <= seen("deaths")
    assert {EventKind.LEFT, EventKind.JOINED} <= seen("operator")
    assert modes("operator") == set(Mode)
    assert EventKind.LIMIT_HIT in seen("limits") & seen("end stop")
    assert {r.status for r in robots("operator")} == set(Status)
    # Robots that keep still take part all the same.
    assert any(r.broadcast_step == NEVER and r.status == Status.ACTIVE for r in robots("operator"))
    ages = {r.step - r.broadcast_step for r in robots("bad network") if r.broadcast_step != NEVER}
    assert max(ages) >= 6
    assert world("clocks").collector.different > 0


# A bit is changed


def flipped(stored: Stored, bit: int) -> Stored:
    data = bytearray(stored.payload)
    data[bit // 8] ^= 1 << bit % 8
    return stored._replace(payload=bytes(data))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_changed_bit_of_a_command_is_found_and_named(data: st.DataObject) -> None:
    recorded = world(data.draw(st.sampled_from(["brief", "brief on a bad network"])))
    states = [n for n, stored in enumerate(recorded.bag) if stored.topic is AGENT_STATE]
    number = data.draw(st.sampled_from(states[4:]))
    stored = recorded.bag[number]
    bit = 8 * (len(stored.payload) - 8) + data.draw(st.integers(0, 63))
    state = stored.message
    assert isinstance(state, AgentState)
    bag = [*recorded.bag[:number], flipped(stored, bit), *recorded.bag[number + 1 :]]
    found = verify(recorded.scenario, bag).difference
    before = [m for m in messages(recorded.bag) if isinstance(m, AgentState) and m.agent_id == state.agent_id]
    after_gap = before.index(state) == 0 or before[before.index(state) - 1].step < state.step - 1
    # A robot at rest may command 0 or -0.
    if not after_gap and state.command != 0.0:
        assert found is not None
        assert (found.topic, found.step, found.agent) == (AGENT_STATE.name, state.step, state.agent_id)
        assert found.field in {"command", "payload"}


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_a_changed_bit_anywhere_is_found(data: st.DataObject) -> None:
    recorded = world("brief")
    bag = list(recorded.bag)
    number = data.draw(st.sampled_from([n for n, s in enumerate(bag) if s.topic is not EVENTS and s.message.step > 5]))
    bit = data.draw(st.integers(0, 8 * len(bag[number].payload) - 1))
    if bag[number].topic is AGENT_STATE and 4 <= bit // 8 < 12:
        return  # when within its step a robot has measured, nobody knows
    bag[number] = flipped(bag[number], bit)
    found = verify(recorded.scenario, bag)
    if found.difference is None:  # a step or a time that now belongs to nothing: then something else lacks it
        assert found.not_checkable.total() > 0


def place(found: Difference | None) -> tuple[str, int | None, int | None, str]:
    assert found is not None
    return found.topic, found.step, found.agent, found.field


# Robots and coordinators that cheat consistently


def run_with(
    monkeypatch: pytest.MonkeyPatch, owner: object, name: str, replacement: Any, seconds: float = 1.0
) -> Recorded:
    scenario = builtin("pd_het_4")
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, replacement)
        fleet = VirtualFleet(scenario)
        fleet.run(seconds)
    return record(fleet, scenario)


def test_a_robot_whose_command_is_one_bit_off_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    honest = agent.RealtimeLaw.decide

    def decide(self: agent.RealtimeLaw, position: float, velocity: float, heard: Any) -> Any:
        decision, limited = honest(self, position, velocity, heard)
        higher = decision._replace(command=math.nextafter(decision.command, math.inf))
        return higher if heard.step == 60 else decision, limited

    recorded = run_with(monkeypatch, agent.RealtimeLaw, "decide", decide)
    found = verify(recorded.scenario, recorded.bag).difference
    assert place(found) == (AGENT_STATE.name, 62, 1, "command")


def test_a_robot_that_follows_what_is_too_old_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = builtin("pd_het_4")
    with monkeypatch.context() as patch:
        patch.setattr(BroadcastInbox, "problem", lambda inbox, _: "" if inbox.newest else "nothing heard")
        fleet = VirtualFleet(scenario)
        fleet.run(0.5)
        fleet.network.cut = {"agent_002"}
        fleet.run(0.5)
    recorded = record(fleet, scenario)
    found = verify(recorded.scenario, recorded.bag).difference
    assert place(found)[2:] == (2, "broadcast_step")
    assert found is not None and "11 steps old" in found.reason


def test_a_robot_that_does_not_stop_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = builtin("pd_het_4")
    with monkeypatch.context() as patch:
        patch.setattr(BroadcastInbox, "problem", lambda inbox, _: "" if inbox.newest else "nothing heard")
        fleet = VirtualFleet(scenario)
        fleet.run(0.505)
        fleet.call(CONTROLLER, lambda node, now: node.stop(now))  # type: ignore[attr-defined]
        fleet.run(0.3)
    recorded = record(fleet, scenario)
    found = verify(recorded.scenario, recorded.bag).difference
    assert place(found)[2:] == (1, "broadcast_step")
    assert found is not None and "asked for STOP" in found.reason


def edited(
    bag: Sequence[Stored], kind: type, of_step: int, source: Source | None = None, **fields: object
) -> list[Stored]:
    """Return the bag with the first message of a class and step, if it is a basis of a source, changed."""
    out = list(bag)
    number = next(
        n
        for n, m in enumerate(messages(bag))
        if isinstance(m, kind) and m.step == of_step and getattr(m, "source", None) == source
    )
    message: Any = out[number].message
    out[number] = out[number]._replace(payload=encode(message._replace(**fields)))
    return out


@pytest.mark.parametrize(
    ("kind", "fields", "named"),
    [
        (AgentState, {"status": 2}, "status"),
        (AgentState, {"mass": 1.0}, "mass"),
        (AgentState, {"position": 0.2}, "position"),
        (PlaneState, {"angle": 0.1}, "angle"),
        (PlaneState, {"stamp": EPOCH}, "stamp"),
        (DesiredAbstractState, {"torque": 0.1}, "torque"),
        (DesiredAbstractState, {"mode": Mode.STOP}, "inertia"),
        (Basis, {"source": Source.OBSERVER, "state_steps": (100, 100, 100, 99)}, "torque"),
        (Basis, {"source": Source.OBSERVER, "state_steps": (100, 100, 100, 103)}, "state_steps"),
        (Basis, {"source": Source.OBSERVER, "agent_ids": (1, 2, 4, 3)}, "agent_ids"),
        (Basis, {"source": Source.PLANE, "state_steps": (100, 100, 100, 99)}, "angle"),
        (Basis, {"source": Source.OBSERVER, "standing": (0, 1, 0, 0)}, "torque_rate"),
        (Basis, {"source": Source.OBSERVER, "state_steps": (100, 50, 100, 100)}, "standing"),
        (Basis, {"source": Source.PLANE, "begun": 50}, "begun"),
    ],
)
def test_what_was_edited_is_named(kind: type, fields: dict[str, Any], named: str) -> None:
    recorded = world("quiet")
    found = verify(recorded.scenario, edited(recorded.bag, kind, 100, **fields)).difference
    assert found is not None
    assert found.step in {100, 101}
    assert found.field == named or (kind is DesiredAbstractState and "mode" in fields)


def test_a_message_that_stands_there_twice_is_found() -> None:
    recorded = world("quiet")
    number = next(n for n, s in enumerate(recorded.bag) if s.topic is PLANE_STATE and s.message.step == 50)
    bag = [*recorded.bag[: number + 3], recorded.bag[number], *recorded.bag[number + 3 :]]
    assert place(verify(recorded.scenario, bag).difference) == (PLANE_STATE.name, 50, None, "message")


def test_a_robot_that_is_not_in_the_scenario_is_found() -> None:
    recorded = world("quiet")
    assert place(verify(recorded.scenario, edited(recorded.bag, AgentState, 50, agent_id=9)).difference)[2:] == (
        9,
        "message",
    )


def test_with_a_tolerance_small_differences_pass() -> None:
    recorded = world("quiet")
    state = next(m for m in messages(recorded.bag) if isinstance(m, PlaneState) and m.step == 100)
    bag = edited(recorded.bag, PlaneState, 100, angle=state.angle + 1e-12)
    assert verify(recorded.scenario, bag).difference is not None
    assert verify(recorded.scenario, bag, tolerance=1e-6).difference is None


# What cannot be known


def without(bag: Iterable[Stored], kind: type, steps: range) -> list[Stored]:
    return [s for s in bag if not (isinstance(s.message, kind) and s.message.step in steps)]


def test_without_bases_only_the_robots_are_checked() -> None:
    recorded = world("quiet")
    found = verify(recorded.scenario, [s for s in recorded.bag if s.topic is not BASIS])
    robots = sum(s.topic is AGENT_STATE for s in recorded.bag)
    assert found.difference is None
    assert (found.messages, found.not_checkable) == (
        robots,
        Counter({"what it was computed from is not in the bag": of_main_topics(recorded.bag) - robots}),
    )


def test_a_measured_plane_and_driven_robots_are_not_recomputed() -> None:
    recorded = world("quiet")
    bag = edited(recorded.bag, PlaneState, 150, stamp=EPOCH)
    found = verify(recorded.scenario, bag, robots=(), plane=False)
    assert found.difference is None
    assert found.not_checkable["it was measured"] == sum(s.topic is PLANE_STATE for s in bag)
    moved = edited(recorded.bag, AgentState, 150, position=0.2)
    found = verify(recorded.scenario, moved, robots=(), plane=False)
    assert place(found.difference)[3] == "torque"


def test_a_law_with_memory_is_followed_again_after_a_reset() -> None:
    recorded = world("operator")
    adaptive = world("adaptive")
    lost = without(adaptive.bag, PlaneState, range(50, 51))
    answers = sum(s.topic is DESIRED_ABSTRACT_STATE and s.message.step > 50 for s in lost)
    found = verify(adaptive.scenario, lost)
    assert found.difference is None
    assert found.not_checkable["the answer from which it goes on is not in the bag"] >= answers
    # A law without memory is found again at once.
    found = verify(recorded.scenario, without(recorded.bag, PlaneState, range(50, 51)))
    assert found.difference is None
    assert found.not_checkable.total() <= 4


def test_what_comes_from_nowhere_gives_a_difference_and_no_error() -> None:
    recorded = world("quiet")
    draw = Random(1)
    for _ in range(60):
        bag = list(recorded.bag[:400])
        number = draw.randrange(400)
        bag[number] = bag[number]._replace(payload=draw.randbytes(draw.randrange(120)))
        assert place(verify(recorded.scenario, bag).difference)[3] == "payload"


@pytest.mark.parametrize("step", [2**63, 5000, 50])
def test_a_wrong_step_is_found(step: int) -> None:
    recorded = world("quiet")
    assert verify(recorded.scenario, edited(recorded.bag, AgentState, 150, step=step)).difference is not None


def test_the_epoch_of_1970_gives_large_steps() -> None:
    recorded = world("quiet")
    period = recorded.scenario.step_ns
    first = EPOCH // period
    moved: list[Stored] = []
    for stored in recorded.bag:
        message: Any = stored.message
        changes = {"step": message.step + first}
        for name in ("broadcast_step", "since", "begun"):
            if getattr(message, name, NEVER) != NEVER:
                changes[name] = getattr(message, name) + first
        if isinstance(message, Basis):
            changes["state_steps"] = tuple(step + first for step in message.state_steps)
        moved.append(stored._replace(payload=encode(message._replace(**changes))))
    verification = started(recorded.scenario, Schedule(period))
    for stored in moved:
        verification.add(*stored)
    verification.finish()
    assert verification.found.difference is None
    assert verification.found.messages == of_main_topics(recorded.bag)


def test_a_clock_that_is_set_years_ahead_takes_no_time() -> None:
    recorded = world("brief")
    period = recorded.scenario.step_ns
    jump = 10**12
    moved: list[Stored] = []
    for stored in recorded.bag:
        message: Any = stored.message
        if message.step < 30:
            moved.append(stored)
        else:
            later = message._replace(step=message.step + jump, stamp=message.stamp + 10**16)
            moved.append(stored._replace(time=stored.time + jump * period, payload=encode(later)))
    found = verify(recorded.scenario, moved)
    assert found.difference is not None  # nobody has said that the clock was set
