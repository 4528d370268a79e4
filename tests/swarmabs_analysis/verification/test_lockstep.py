"""Verification of runs that are right, of runs in which a bit was changed, and of robots that cheat consistently."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from tests.plugin_packages import SCALED, install
from tests.swarmabs_core.helpers import builtin, digest

from swarmabs_analysis.difference import Difference
from swarmabs_analysis.verification.base import Verdict
from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_config import configure
from swarmabs_config.scenario import Scenario
from swarmabs_core import controllers, desired_state, drive, plant
from swarmabs_core.behaviours import Agent, AgentConfig, Observer
from swarmabs_core.cdr import agent_id_of, decode, encode
from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.membership import SILENT
from swarmabs_core.messages import (
    AGENT_STATE,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Kind,
    Message,
    Messages,
    SwarmEvent,
    Topic,
)
from swarmabs_run import simulation
from swarmabs_run.simulation import Simulation

SHORT = "duration=0.6"
FAULTS = (
    "faults=[{at: 0.1, kind: join, agent: 4}, {at: 0.2, kind: kill, agent: 1}, {at: 0.4, kind: leave, agent: 4},"
    " {kind: loss, probability: 0.2}, {kind: delay, steps: 2}]"
)
FAULTS_OF_MESSAGES = (
    "faults=[{kind: duplication, probability: 0.5}, {kind: reordering, probability: 0.4, steps: 3, from: 0.1},"
    " {kind: clock_offset, agent: 1, offset: -0.25, from: 0.05, to: 0.4}, {at: 0.2, kind: kill, agent: 2},"
    " {kind: lie, agent: 3, position_offset: 0.01, position_factor: 1.1, mass_factor: 0.9, from: 0.1, to: 0.4},"
    " {kind: loss, probability: 0.3, agents: [3], from: 0.2, to: 0.5},"
    " {kind: delay, steps: 2, agents: [1, 4], to: 0.3}]"
)
NOISE = ("swarm.sensor={noise: [1.0e-4, 1.0e-3], resolution: [1.0e-5, 0]}", "plane.sensor={noise: [1.0e-4, 1.0e-3]}")
WORLDS: dict[str, tuple[str, ...]] = {
    "faults": ("pd_het_4", SHORT, FAULTS),
    "faults of messages": ("pd_het_4", SHORT, FAULTS_OF_MESSAGES),
    "freeze": ("pd_het_4", SHORT, "faults=[{at: 0.2, kind: freeze, agent: 3}]"),
    "adaptive controller and disturbance": ("arise_het_4", SHORT),
    "many robots, on arrays": ("arise_het_20", "duration=0.2"),
    "limits": ("pd_het_4", SHORT, "limits={velocity: 0.05, force: 0.1}", "manifold.torque_max=0.2"),
    "noise": ("pd_het_4", SHORT, *NOISE),
    "actuator lag": ("pd_het_4", SHORT, "swarm.actuator_lag=0.03", FAULTS),
    "gravity on robots": ("pd_di_4", SHORT, "plane.robot_gravity=true"),
    "end stop": ("pd_het_4", SHORT, "plane.angle=0.05", "plane.angular_velocity=4", "plane.end_stop=0.06"),
    "torque from the plane": ("pd_si_4", SHORT, "observer={type: parent_response}"),
    "safe stop": ("pd_het_4", SHORT, "plane.length=115000"),
}


class Stored(NamedTuple):
    """A message of a bag: topic, log time in ns, bytes."""

    topic: Topic
    time: int
    payload: bytes

    @property
    def message(self) -> Message:
        return decode(self.topic.message, self.payload)

    def changed(self, **fields: object) -> Stored:
        message: Any = self.message
        return self._replace(payload=encode(message._replace(**fields)))


@cache
def world(*named: str) -> Scenario:
    return builtin(*named)


def record(scenario: Scenario) -> list[Stored]:
    """Return what a bag of the scenario holds."""
    return [Stored(*stored) for step in Simulation(scenario).steps() for stored in step.stored()]


@cache
def recorded(*named: str) -> tuple[Stored, ...]:
    return tuple(record(world(*named)))


def verify(scenario: Scenario, bag: Iterable[Stored], *, whole: bool = True, tolerance: float = 0.0) -> Verdict:
    verification = LockstepVerification(scenario, tolerance=tolerance)
    for stored in bag:
        verification.add(*stored)
    verification.finish(whole=whole)
    return verification.found


def first_difference(scenario: Scenario, bag: Iterable[Stored], **options: Any) -> Difference:
    difference = verify(scenario, bag, **options).difference
    assert difference is not None
    return difference


def events_of(bag: Iterable[Stored]) -> list[SwarmEvent]:
    return [event for event in (s.message for s in bag) if isinstance(event, SwarmEvent)]


def place(difference: Difference) -> tuple[str, int | None, int | None, str]:
    return difference.topic, difference.step, difference.agent, difference.field


@pytest.mark.parametrize("name", WORLDS)
def test_a_right_run_is_found_right_and_has_its_digest(name: str) -> None:
    scenario = world(*WORLDS[name])
    steps = list(simulation.simulated_steps(scenario))
    bag = [Stored(*stored) for step in steps for stored in step.stored()]
    found = verify(scenario, bag)
    assert found.difference is None
    assert (found.steps, found.messages) == (scenario.steps + 1, len(bag))
    assert found.digest == digest(steps)


def test_the_worlds_have_what_they_are_there_for() -> None:
    def kinds(name: str) -> set[tuple[int, bool]]:
        return {(e.kind, bool(e.agent_id)) for e in events_of(recorded(*WORLDS[name]))}

    assert (EventKind.SAFE_STOP, True) in kinds("safe stop")
    assert kinds("limits") >= {(EventKind.LIMIT_HIT, True), (EventKind.LIMIT_HIT, False)}
    assert (EventKind.LIMIT_HIT, False) in kinds("end stop")
    assert {kind for kind, _ in kinds("faults")} >= {EventKind.JOINED, EventKind.LEFT, EventKind.DEAD}


# A bit is changed


def changed_fields(original: Stored, changed: Stored) -> set[str]:
    """Return the fields in which two messages differ, by their bytes one by one."""
    try:
        one, other = original.message, changed.message
    except MalformedMessageError:
        return {"payload"}
    same: Any = one
    differ = {n for n in one._fields if encode(same._replace(**{n: getattr(other, n)})) != original.payload}
    return differ or {"padding"}


@settings(max_examples=300)
@given(st.data())
def test_a_changed_bit_is_found_and_named(data: st.DataObject) -> None:
    named = WORLDS["faults"]
    bag = list(recorded(*named))
    events = [n for n, stored in enumerate(bag) if stored.topic is EVENTS]
    index = data.draw(st.one_of(st.integers(0, len(bag) - 1), st.sampled_from(events)))
    original = bag[index]
    bit = data.draw(st.integers(0, 8 * len(original.payload) - 1))
    flipped = bytearray(original.payload)
    flipped[bit // 8] ^= 1 << bit % 8
    bag[index] = original._replace(payload=bytes(flipped))
    found = first_difference(world(*named), bag)
    fields = changed_fields(original, bag[index])
    assert (found.topic, found.step) == (original.topic.name, original.message.step)
    assert found.field in fields
    assert found.agent == (None if fields == {"payload"} else agent_id_of(original.message) or None)
    if not fields <= {"payload", "padding"}:
        assert found.a is not None and repr(found.a) != repr(found.b)  # -0.0 == 0.0


def test_the_time_of_a_message_in_the_bag_counts() -> None:
    named = ("pd_het_4", SHORT)
    bag = list(recorded(*named))
    index = next(n for n, s in enumerate(bag) if s.topic is PLANE_STATE and s.message.step == 7)
    bag[index] = bag[index]._replace(time=80_000_000)
    found = first_difference(world(*named), bag)
    assert place(found) == ("plane/state", 7, None, "log_time")
    assert (found.a, found.b) == (80_000_000, 70_000_000)


@pytest.mark.parametrize("sort", ["agent", "plane", "event"])
def test_missing_repeated_and_foreign_messages_are_named(sort: str) -> None:
    named = WORLDS["faults"]
    bag, scenario = list(recorded(*named)), world(*named)
    topic = {"agent": AGENT_STATE, "plane": PLANE_STATE, "event": EVENTS}[sort]
    index = next(n for n, s in enumerate(bag) if s.topic is topic and s.message.step >= 20)
    one = bag[index]
    named_place = (topic.name, one.message.step, agent_id_of(one.message) or None, "message")
    without = first_difference(scenario, bag[:index] + bag[index + 1 :])
    assert place(without) == named_place
    assert without.a is None and isinstance(without.b, dict)
    for again in (index + 1, index + 40):
        twice = first_difference(scenario, [*bag[:again], one, *bag[again:]])
        assert place(twice) == named_place
        assert twice.b is None and isinstance(twice.a, dict)


def test_a_step_beyond_the_end_is_found() -> None:
    named = ("pd_het_4", SHORT)
    bag = list(recorded(*named))
    beyond = bag[-1].changed(step=61, stamp=610_000_000)._replace(time=610_000_000)
    found = first_difference(world(*named), [*bag, beyond])
    assert place(found) == ("swarm/desired_abstract_state", 61, None, "message")


def test_messages_may_come_in_another_order() -> None:
    named = WORLDS["faults"]
    bag = list(recorded(*named))
    late = [n for n, s in enumerate(bag) if s.topic is EVENTS]
    moved = bag.pop(late[len(late) // 2])
    bag.append(moved)
    assert verify(world(*named), bag).difference is None
    random = Random(3)
    bag.sort(key=lambda s: s.message.step + random.random() * 30)
    assert verify(world(*named), bag).difference is None


@pytest.mark.parametrize("step", [0, 50])
def test_endless_repetitions_are_not_gathered(step: int) -> None:
    named = WORLDS["faults"]
    one = next(s for s in recorded(*named) if s.topic is PLANE_STATE and s.message.step == step)
    verification = LockstepVerification(world(*named))
    for _ in range(10_000):
        verification.add(*one)
        if verification.decided:
            return
    pytest.fail("they are gathered")


def test_a_missing_event_comes_before_a_later_difference() -> None:
    named = WORLDS["faults"]
    bag = list(recorded(*named))
    index = next(n for n, s in enumerate(bag) if s.topic is EVENTS and s.message.step == 21)
    event = bag.pop(index)
    last = max(n for n, s in enumerate(bag) if s.topic is PLANE_STATE)
    bag[last] = bag[last].changed(angle=1.0)
    assert place(first_difference(world(*named), bag)) == ("swarm/events", 21, 1, "message")
    assert place(first_difference(world(*named), [*bag, event])) == ("plane/state", 60, None, "angle")


# A robot cheats, and what it does afterwards fits


def run_with(monkeypatch: pytest.MonkeyPatch, scenario: Scenario, make: Callable[[AgentConfig], Agent]) -> list[Stored]:
    """Return a whole run, closed loop and all, in which robots are made otherwise."""
    with monkeypatch.context() as patch:
        patch.setattr(simulation, "Agent", make)
        return record(scenario)


class Nudged(Agent):
    """A robot that adds one unit in the last place to one command, and goes on by the law."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        law = self._controller.follow

        def nudged(p: float, v: float, abstract: AbstractState, *others: Any) -> float:
            command = law(p, v, abstract, *others)
            return math.nextafter(command, math.inf) if abstract.step == 30 else command

        self._controller.follow = nudged


@pytest.mark.parametrize("robot", [1, 3])
def test_one_bit_of_one_command_is_found_although_all_that_follows_fits(
    monkeypatch: pytest.MonkeyPatch, robot: int
) -> None:
    scenario = world("pd_het_4", SHORT)
    bag = run_with(monkeypatch, scenario, lambda c: (Nudged if c.agent_id == robot else Agent)(c))
    found = first_difference(scenario, bag)
    assert place(found) == ("swarm/agent_state", 31, robot, "command")
    assert found.a == math.nextafter(float(str(found.b)), math.inf)
    assert verify(scenario, bag, tolerance=1e-9).difference is None


@pytest.mark.parametrize(
    ("change", "step", "field"),
    [
        ({"gains": replace(configure.agent_configs(builtin("pd_het_4"))[0].gains, kp=(10.0, 10.000001))}, 1, "command"),
        ({"mass": 0.6763}, 0, "mass"),
        ({"damping": 0.6523}, 0, "damping"),
        ({"position": 0.1250001}, 0, "position"),
        ({"kind": Kind.SINGLE_INTEGRATOR, "damping": 0.0}, 0, "kind"),
        ({"plane_length": 1e6}, 1, "status"),
        ({"feels_gravity": True}, 1, "velocity"),
    ],
)
def test_a_robot_that_is_not_the_one_of_the_scenario_is_found(
    monkeypatch: pytest.MonkeyPatch, change: dict[str, Any], step: int, field: str
) -> None:
    scenario = world("pd_het_4", SHORT)
    bag = run_with(monkeypatch, scenario, lambda c: Agent(replace(c, **change) if c.agent_id == 3 else c))
    assert place(first_difference(scenario, bag)) == ("swarm/agent_state", step, 3, field)


def test_a_law_of_another_package_is_verified_by_that_law(packages: Path) -> None:
    install(packages, "law", "scaled", SCALED)
    scenario = builtin("pd_het_4", SHORT, "swarm.law={type: scaled, factor: 1.1, bad_mass: 0.3532}")
    bag = record(scenario)
    assert (EventKind.SAFE_STOP, 2) in {(e.kind, e.agent_id) for e in events_of(bag)}
    assert verify(scenario, bag).difference is None
    paper = builtin("pd_het_4", SHORT)
    assert place(first_difference(paper, bag)) == ("swarm/agent_state", 1, 1, "command")


def test_commands_fit_an_algebraically_different_form_of_the_law() -> None:
    """Each law is m (g z0 + 2 p z1) with z from the normal equations of Phi: no row of a pseudo-inverse, no C_a."""
    named = ("pd_het_4", SHORT)
    messages = [stored.message for stored in recorded(*named)]
    assert verify(world(*named), recorded(*named)).difference is None
    one = {(type(m), m.step): m for m in messages if not isinstance(m, (AgentState, SwarmEvent))}
    states = {(m.step, m.agent_id): m for m in messages if isinstance(m, AgentState)}
    g, ksd = 9.81, 1.0
    checked = 0
    for (step, agent_id), after in states.items():
        if step == 0:
            continue
        team = [states[step - 1, i] for i in (1, 2, 3, 4)]
        m, p, v = (np.array([getattr(s, name) for s in team]) for name in ("mass", "position", "velocity"))
        damping = np.array([s.damping + ksd if s.kind == Kind.DOUBLE_INTEGRATOR else 0.0 for s in team])
        jacobian = np.array([g * m, 2.0 * m * p])
        row = agent_id - 1
        abstract, desired = one[AbstractState, step - 1], one[DesiredAbstractState, step - 1]
        assert isinstance(abstract, AbstractState) and isinstance(desired, DesiredAbstractState)
        e = np.array([desired.torque - abstract.torque, desired.inertia - abstract.inertia])

        def answer(y: np.ndarray[Any, Any], jacobian: np.ndarray[Any, Any] = jacobian, row: int = row) -> float:
            return float((jacobian.T @ np.linalg.solve(jacobian @ jacobian.T, y))[row])

        if after.kind == Kind.SINGLE_INTEGRATOR:
            expected = answer(10.0 * e + [desired.mean_torque_rate, desired.mean_inertia_rate])
        else:
            rate = np.array([desired.torque_rate, desired.inertia_rate])
            de = rate - [abstract.torque_rate, abstract.inertia_rate]
            acceleration = np.array([desired.torque_acceleration, desired.inertia_acceleration])
            # damping acts on the swarm as Phi diag(c/m) Phi+ acts on the rate of the abstract state
            drag = jacobian @ ((damping / m) * (jacobian.T @ np.linalg.solve(jacobian @ jacobian.T, de)))
            y = 10.0 * e + 5.0 * de - drag - [0.0, 2.0 * float(np.sum(m * v * v))] + acceleration
            expected = m[row] * answer(y) + damping[row] * answer(rate) - ksd * v[row]
        assert after.command == pytest.approx(expected, rel=1e-7, abs=1e-9)
        checked += 1
    assert checked == 240


# Robots that are dropped, and runs that end early


class Silent(Agent):
    """A robot whose process hangs before its state of step 30."""

    def handle(self, message: Message) -> Messages:
        return () if message.step >= 29 else super().handle(message)


class Dropping(Observer):
    """An observer whose patience with robot 2 ends."""

    def handle(self, message: Message) -> Messages:
        answers = super().handle(message)
        return (*answers, *self.drop((2,), SILENT)) if self._waits_for() == (30, (2,)) else answers

    def _waits_for(self) -> tuple[int, tuple[int, ...]]:
        return self.missing()[0], self.missing_agents()


def test_a_robot_that_was_dropped_is_taken_from_the_record(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = world("pd_het_4", SHORT, "lockstep.on_stall=drop")
    with monkeypatch.context() as patch:
        patch.setattr(simulation, "Observer", Dropping)
        bag = run_with(patch, scenario, lambda c: (Silent if c.agent_id == 2 else Agent)(c))
    assert verify(scenario, bag).difference is None
    index = next(n for n, s in enumerate(bag) if s.topic is EVENTS)
    elsewhere = [*bag[:index], bag[index].changed(value=0.0), *bag[index + 1 :]]
    assert place(first_difference(scenario, elsewhere)) == ("swarm/events", 30, 2, "value")
    unannounced = bag[:index] + bag[index + 1 :]
    assert place(first_difference(scenario, unannounced)) == ("swarm/agent_state", 30, 2, "message")
    refused = world("pd_het_4", SHORT)
    assert place(first_difference(refused, bag)) == ("swarm/agent_state", 30, 2, "message")


def test_a_run_that_ended_early_is_verified_as_far_as_it_goes() -> None:
    named = WORLDS["faults"]
    scenario, bag = world(*named), recorded(*named)
    early = [stored for stored in bag if stored.message.step <= 40]
    found = verify(scenario, early, whole=False)
    assert (found.difference, found.steps) == (None, 41)
    unsaid = first_difference(scenario, early)
    assert place(unsaid) == ("swarm/agent_state", 41, None, "message")
    assert "does not say why" in unsaid.reason


def test_a_bag_that_is_cut_off_anywhere_is_verified_up_to_there() -> None:
    named = WORLDS["faults"]
    scenario, bag = world(*named), recorded(*named)
    for length in range(0, len(bag), 7):
        found = verify(scenario, bag[:length], whole=False)
        assert found.difference is None
        rest = [s for s in bag[:length] if s.message.step >= found.steps]
        assert found.messages >= length - len(rest)
        assert len({s.message.step for s in rest}) <= 1
    changed = [*bag[:200], bag[200].changed(stamp=1), *bag[201:203]]
    assert verify(scenario, changed, whole=False).difference is not None


def test_a_bag_that_says_so_may_break_off_within_its_last_step() -> None:
    named = ("pd_het_4", SHORT)
    scenario, bag = world(*named), recorded(*named)
    begin = next(n for n, s in enumerate(bag) if s.message.step == 40)
    for length in range(9):
        found = verify(scenario, bag[: begin + length], whole=False)
        assert found.difference is None
        assert (found.steps, found.messages) == (40 + (length == 8), begin + length)
        assert found.digest == verify(scenario, bag[: begin + 8 * (length == 8)], whole=False).digest
    for n in range(begin, begin + 7):  # what is there of it is still compared
        part = [*bag[:n], bag[n].changed(stamp=1), *bag[n + 1 : begin + 7]]
        found_there = first_difference(scenario, part, whole=False)
        assert place(found_there) == (bag[n].topic.name, 40, agent_id_of(bag[n].message) or None, "stamp")
    for n in (begin + 1, begin + 4, begin + 6):  # a hole is no end
        hole = [*bag[:n], *bag[n + 1 : begin + 8]]
        assert place(first_difference(scenario, hole, whole=False))[:2] == (bag[n].topic.name, 40)
        before = [*bag[: n - 8], *bag[n - 7 : begin + 5]]
        assert place(first_difference(scenario, before, whole=False))[:2] == (bag[n].topic.name, 39)
    unsaid = first_difference(scenario, bag[: begin + 2])
    assert place(unsaid) == ("swarm/agent_state", 40, 3, "message")


def test_a_robot_that_takes_the_name_of_another_is_named_whatever_the_clock_of_the_other() -> None:
    named = ("pd_het_4", SHORT, "faults=[{kind: clock_offset, agent: 4, offset: 0.05}]")
    bag = list(recorded(*named))
    index = next(n for n, s in enumerate(bag) if s.message.step == 9 and agent_id_of(s.message) == 1)
    bag[index] = bag[index].changed(agent_id=4)
    found = first_difference(world(*named), bag)
    assert place(found) == ("swarm/agent_state", 9, 1, "agent_id")
    assert (found.a, found.b) == (4, 1)


def test_a_run_that_had_to_fail_cannot_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    named = ("pd_het_4", SHORT, "plane.angle=1.45", "plane.angular_velocity=5")
    scenario = world(*named)
    steps = []
    with pytest.raises(RunError, match=r"1\.5 rad"):
        steps.extend(Simulation(scenario).steps())
    with monkeypatch.context() as patch:
        patch.setattr(desired_state, "STEEPEST", 10.0)
        bag = record(scenario)
    found = first_difference(scenario, bag)
    assert (found.topic, found.field, found.b) == (DESIRED_ABSTRACT_STATE.name, "message", None)
    assert "1.5 rad" in found.reason
    assert found.step is not None
    before = [stored for stored in bag if stored.message.step < found.step]
    assert verify(scenario, before, whole=False).difference is None


def auxiliary(bag: Sequence[Stored], step: int) -> int:
    return next(n for n, s in enumerate(bag) if isinstance(s.message, AuxiliaryState) and s.message.step == step)


def test_signs_of_zero_and_not_a_number_are_bits_too() -> None:
    named = ("pd_si_4", SHORT)
    scenario, bag = world(*named), list(recorded(*named))
    index = auxiliary(bag, 3)  # single integrators only: D0 is 0
    for value in (-0.0, math.nan, -math.inf):
        bag[index] = bag[index].changed(d0=value)
        found = first_difference(scenario, bag)
        assert place(found) == ("swarm/auxiliary_state", 3, None, "d0")
        assert repr(found.a) == repr(value)
        if value:
            assert found.to_dict("recorded", "recomputed")["recorded"] == repr(value)
            assert place(first_difference(scenario, bag, tolerance=0.1)) == place(found)


def last_bit_wrong(function: Callable[[float], float]) -> Callable[[float], float]:
    def other(x: float) -> float:
        odd = int.from_bytes(struct.pack("<d", x), "little") & 1
        return math.nextafter(function(x), math.inf) if odd else function(x)

    return other


def test_another_mathematical_library_needs_a_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = world("arise_het_4", "duration=2")
    with monkeypatch.context() as patch:
        for module in (plant, drive, desired_state, controllers):
            for name in ("tanh", "cos", "sin", "exp", "expm1"):
                if hasattr(module, name):
                    patch.setattr(module, name, last_bit_wrong(getattr(math, name)))
        bag = record(scenario)
    assert verify(scenario, bag).difference is not None
    assert verify(scenario, bag, tolerance=1e-9).difference is None
    index = next(n for n, s in enumerate(bag) if s.topic is AGENT_STATE and s.message.step == 90)
    state = bag[index].message
    assert isinstance(state, AgentState)
    bag[index] = bag[index].changed(command=state.command + 1e-8)
    assert place(first_difference(scenario, bag, tolerance=1e-9)) == ("swarm/agent_state", 90, 1, "command")
