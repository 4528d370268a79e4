"""Verification of runs that are right, of runs in which a bit was changed, and of robots that cheat consistently."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st
from tests.swarmabs_bag.mcap_files import message
from tests.swarmabs_core.helpers import builtin, digest
from tests.swarmabs_core.realtime.bags import Stored

from swarmabs_analysis.difference import Difference, component_of
from swarmabs_analysis.verification.base import Verification, VerificationResult
from swarmabs_analysis.verification.earlier import are_earlier
from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_bag.mcap.stored import ChunkContent
from swarmabs_bag.run.grouping import Published, TopicMessages, whole_steps
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.scenario import Scenario
from swarmabs_core import desired_state, messages as msg
from swarmabs_core.behaviours import Agent
from swarmabs_core.cdr import agent_id_of, encode
from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.membership import ALWAYS, SILENT
from swarmabs_core.models import AgentConfig
from swarmabs_core.ranges import crossing_of
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
ENDS = (
    "faults=[{at: 0.1, kind: join, agent: 4}, {at: 0.2, kind: kill, agent: 1}, {at: 0.3, kind: disturbance, torque: 1},"
    " {at: 0.4, kind: leave, agent: 3}, {at: 0.4, kind: reference, offset: 0.01},"
    " {at: 0.5, kind: disturbance, torque: 0}, {kind: loss, probability: 0.5, from: 0.5, to: 0.52}]"
)
HEIGHTS = (*(f"swarm.agents.{n}.center_height={0.02 * n}" for n in range(4)), "plane={mass: 2, center_height: -0.05}")
DRIVES = "faults=[{kind: drive_failure, agent: 1, from: 0.2}, {at: 0.4, kind: kill, agent: 1}]"
NOISE = ("swarm.sensor={noise: [1.0e-4, 1.0e-3], resolution: [1.0e-5, 0]}", "plane.sensor={noise: [1.0e-4, 1.0e-3]}")
WORLDS: dict[str, tuple[str, ...]] = {
    "faults": ("pd_het_4", SHORT, FAULTS),
    "faults of messages": ("pd_het_4", SHORT, FAULTS_OF_MESSAGES),
    "freeze": ("pd_het_4", SHORT, "faults=[{at: 0.2, kind: freeze, agent: 3}]"),
    "adaptive controller and disturbance": ("arise_het_4", SHORT),
    "membership": ("arise_het_4", SHORT, ENDS),
    "many robots, on arrays": ("arise_het_20", "duration=0.2"),
    "limits": ("pd_het_4", SHORT, "limits={velocity: 0.05, force: 0.1}", "manifold.torque_max=0.2"),
    "noise": ("pd_het_4", SHORT, *NOISE),
    "actuator lag": ("pd_het_4", SHORT, "swarm.actuator_lag=0.03", FAULTS),
    "gravity on robots": ("pd_di_4", SHORT, "plane.robot_gravity=true"),
    "end stop": ("pd_het_4", SHORT, "plane.angle=0.05", "plane.angular_velocity=4", "plane.end_stop=0.06"),
    "torque from the plane": ("pd_si_4", SHORT, "observer={type: parent_response}"),
    "robots that fly off": ("pd_het_4", SHORT, "swarm.gains={k: [199, 199], kp: [20000, 20000]}"),
    "robots that touch the end": ("arise_di_4", "duration=0.9", "plane.length=0.28"),
    "heights": ("pd_het_4", SHORT, *HEIGHTS, "plane.disturbance={amplitude: 0.1}"),
    "heights and ends": ("pd_het_4", SHORT, *HEIGHTS, ENDS),
    "heights, lag and failed drives": ("pd_het_4", SHORT, *HEIGHTS, "swarm.actuator_lag=0.03", DRIVES),
    "safe stop": ("pd_het_4", SHORT, "plane.length=115000"),
}


world = cache(builtin)


def changed(stored: Stored, **fields: object) -> Stored:
    message: Any = stored.message
    return stored._replace(payload=encode(message._replace(**fields)))


def flipped(stored: Stored, bit: int) -> Stored:
    data = bytearray(stored.payload)
    data[bit // 8] ^= 1 << bit % 8
    return stored._replace(payload=bytes(data))


def record(scenario: Scenario, division: int | None = None) -> list[Stored]:
    """Return what a bag of the scenario holds; the division is that of `Simulation`."""
    return [Stored(*stored) for step in Simulation(scenario, division=division).steps() for stored in step.stored()]


@cache
def recorded(*named: str) -> tuple[Stored, ...]:
    return tuple(record(world(*named)))


def whole(*named: str) -> tuple[Scenario, list[Stored]]:
    """Return a scenario and what a bag of it holds."""
    return world(*named), list(recorded(*named))


def in_chunks(
    scenario: Scenario, bag: Sequence[Stored], random: Random, sizes: Sequence[int] = (7, 100, 1000)
) -> Iterator[Step | Published]:
    """Return messages as they are read from chunks of so many of them."""
    topics = dict(enumerate((*scenario.family.main, msg.STANDING, msg.EVENTS)))
    numbers = {topic: number for number, topic in topics.items()}

    def chunks() -> Iterator[TopicMessages]:
        rest = [message(numbers[s.topic], s.payload, s.time) for s in bag]
        while rest:
            size = random.choice(sizes)
            chunk, rest = b"".join(rest[:size]), rest[size:]
            yield TopicMessages.of(ChunkContent.of(chunk, 0).messages, topics)

    return whole_steps(chunks(), scenario.family)


def take(verification: LockstepVerification, parts: Iterable[Step | Published]) -> None:
    for part in parts:
        if isinstance(part, Step):
            verification.add_steps(part)
        else:
            verification.add(part.topic, part.time, part.payload)


def verify(
    scenario: Scenario, bag: Iterable[Stored], *, whole: bool = True, tolerance: float = 0.0
) -> VerificationResult:
    """Verify a bag message by message and in blocks, which must give the same."""
    bag = list(bag)
    verification = LockstepVerification(scenario, tolerance=tolerance)
    for stored in bag:
        verification.add(*stored)
    verification.finish(whole=whole)
    blocks = LockstepVerification(scenario, tolerance=tolerance)
    take(blocks, in_chunks(scenario, bag, Random(len(bag))))
    blocks.finish(whole=whole)
    assert repr(blocks.result) == repr(verification.result)
    return verification.result


def first_difference(scenario: Scenario, bag: Iterable[Stored], **options: Any) -> Difference:
    difference = verify(scenario, bag, **options).difference
    assert difference is not None
    return difference


def find(bag: Sequence[Stored], topic: msg.Topic, step: int) -> int:
    """Return where the first message on a topic of a step, or of a later one, stands."""
    return next(n for n, s in enumerate(bag) if s.topic is topic and s.message.step >= step)


def place(difference: Difference | None) -> tuple[str, int | None, int | None, str]:
    assert difference is not None
    return difference.topic, difference.step, difference.agent, difference.field


@pytest.mark.parametrize("name", WORLDS)
def test_a_right_run_is_found_right_and_has_its_digest(name: str) -> None:
    scenario = world(*WORLDS[name])
    steps = list(simulation.simulated_steps(scenario))
    bag = [Stored(*stored) for step in steps for stored in step.stored()]
    verification = LockstepVerification(scenario)
    for stored in bag:
        verification.add(*stored)
        assert verification.step >= stored.message.step - 1  # a step is judged as soon as it is there
    verification.finish()
    result = verification.result
    assert result.difference is None
    assert (result.steps, result.expected_steps, result.messages) == (scenario.steps + 1, scenario.steps + 1, len(bag))
    assert result.digest == digest(steps)


@pytest.mark.parametrize("name", ["membership", "many robots, on arrays", "adaptive controller and disturbance"])
def test_most_steps_without_disturbance_are_verified_at_once(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Steps in which the observer tells how the abstract state divides, 2 s from a change on, are verified one by one.
    scenario, bag = whole(*WORLDS[name], *(("duration=5",) if name == "membership" else ()))
    single: list[bytes] = []
    add = Verification.add
    monkeypatch.setattr(Verification, "add", lambda self, *given: single.append(given[2]) or add(self, *given))
    verification = LockstepVerification(scenario)
    take(verification, in_chunks(scenario, bag, Random(0), [len(bag)]))
    verification.finish()
    assert verification.result.complete
    assert len(single) < (0.6 if name == "membership" else 0.2) * len(bag)


@pytest.mark.parametrize("name", ["robots that fly off", "robots that touch the end", "faults"])
def test_a_bag_of_a_version_before_the_ranges_has_its_own_events(name: str) -> None:
    """Those versions told of each crossing outwards, and of nothing else."""
    scenario, bag = whole(*WORLDS[name])
    half, outside, earlier = scenario.plane.length / 2, set[int](), []
    for stored in bag:
        message: Any = stored.message
        if isinstance(message, msg.AgentState):
            gone, was = abs(message.position) > half, message.agent_id in outside
            (outside.add if gone else outside.discard)(message.agent_id)
            if gone and not was:
                place = msg.EventKind.LIMIT_HIT, message.position, "off the plane's end"
                earlier.append(msg.SwarmEvent(message.stamp, message.step, message.agent_id, *place))
    others = [s for s in bag if not isinstance(s.message, msg.SwarmEvent) or crossing_of(s.message) is None]
    told = [Stored(msg.EVENTS, event.stamp, encode(event)) for event in earlier]
    old = sorted([*others, *told], key=lambda s: s.time)
    assert bool(told) is (name != "faults")
    for events, of_earlier in ((bag, False), (old, True)):
        told_events = [s.message for s in events if isinstance(s.message, msg.SwarmEvent)]
        if told:
            assert are_earlier(told_events, scenario) is of_earlier
        verification = LockstepVerification(scenario, earlier=of_earlier)
        for stored in events:
            verification.add(*stored)
        verification.finish()
        assert verification.result.difference is None
    if told:
        assert first_difference(scenario, old).topic == "swarm/events"
    assert are_earlier((), scenario)


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


@settings(max_examples=15)
@given(st.data())
def test_a_changed_bit_is_found_and_named(data: st.DataObject) -> None:
    scenario, bag = whole(*WORLDS[data.draw(st.sampled_from(("faults", "membership")))])
    events = [n for n, stored in enumerate(bag) if stored.topic is msg.EVENTS]
    index = data.draw(st.one_of(st.integers(0, len(bag) - 1), st.sampled_from(events)))
    original = bag[index]
    bit = data.draw(st.integers(0, 8 * len(original.payload) - 1))
    bag[index] = flipped(original, bit)
    difference = first_difference(scenario, bag)
    fields = changed_fields(original, bag[index])
    assert (difference.topic, difference.step) == (original.topic.name, original.message.step)
    assert component_of(difference.field)[0] in fields
    assert difference.agent == (None if fields == {"payload"} else agent_id_of(original.message) or None)
    if not fields <= {"payload", "padding"}:
        assert difference.a is not None and repr(difference.a) != repr(difference.b)  # -0.0 == 0.0


@pytest.mark.parametrize("sort", ["agent", "plane", "event"])
def test_missing_repeated_and_foreign_messages_are_named(sort: str) -> None:
    scenario, bag = whole(*WORLDS["faults"])
    topic = {"agent": msg.AGENT_STATE, "plane": msg.PLANE_STATE, "event": msg.EVENTS}[sort]
    index = find(bag, topic, 20)
    one = bag[index]
    named_place = (topic.name, one.message.step, agent_id_of(one.message) or None, "message")
    beyond = changed(bag[-1], step=61, stamp=610_000_000)._replace(time=610_000_000)
    assert place(first_difference(scenario, [*bag, beyond]))[1:] == (61, None, "message")
    without = first_difference(scenario, bag[:index] + bag[index + 1 :])
    assert place(without) == named_place
    assert without.a is None and isinstance(without.b, dict)
    for again, copy in ((index + 1, one), (index + 40, one), (index + 1, changed(one, stamp=1))):
        twice = first_difference(scenario, [*bag[:again], copy, *bag[again:]])
        assert place(twice) == named_place
        assert twice.b is None and isinstance(twice.a, dict)


def test_messages_may_come_in_another_order() -> None:
    scenario, bag = whole(*WORLDS["faults"])
    bag.append(bag.pop(find(bag, msg.EVENTS, 21)))
    assert verify(scenario, bag).difference is None
    random = Random(3)
    bag.sort(key=lambda s: s.message.step + random.random() * 30)
    assert verify(scenario, bag).difference is None


@pytest.mark.parametrize("step", [0, 50])
def test_endless_repetitions_are_not_gathered(step: int) -> None:
    named = WORLDS["faults"]
    one = recorded(*named)[find(recorded(*named), msg.PLANE_STATE, step)]
    verification = LockstepVerification(world(*named))
    for _ in range(10_000):
        verification.add(*one)
        if verification.decided:
            return
    pytest.fail("they are gathered")


def test_a_missing_event_comes_before_a_later_difference_and_each_wrong_one_is_compared_with_its_own() -> None:
    scenario, bag = whole(*WORLDS["faults"])
    event = bag.pop(find(bag, msg.EVENTS, 21))
    last = find(bag, msg.PLANE_STATE, 60)
    bag[last] = changed(bag[last], angle=1.0)
    assert place(first_difference(scenario, bag)) == ("swarm/events", 21, 1, "message")
    assert place(first_difference(scenario, [*bag, event])) == ("plane/state", 60, None, "angle")
    scenario, bag = whole("pd_het_4", "duration=1.5", "faults=[{at: 0.2, kind: kill, agent: 1}]")
    event = bag.pop(find(bag, msg.EVENTS, 21))  # a bag that breaks off may lack only events of its last steps
    assert place(first_difference(scenario, bag[:-1], whole=False)) == (
        "swarm/events",
        event.message.step,
        1,
        "message",
    )
    scenario, bag = whole(
        "pd_het_4", SHORT, "faults=[{at: 0.2, kind: kill, agent: 1}, {at: 0.2, kind: leave, agent: 4}]"
    )
    events = [n for n, s in enumerate(bag) if s.topic is msg.EVENTS]
    for n in events:
        bag[n] = changed(bag[n], value=9.0)
    for order in (events, events[::-1]):
        shuffled = [s for s in bag if s.topic is not msg.EVENTS] + [bag[n] for n in order]
        first = bag[order[0]].message
        difference = verify(scenario, sorted(shuffled, key=lambda s: s.message.step)).difference
        assert place(difference) == ("swarm/events", first.step, agent_id_of(first), "value")


@pytest.mark.parametrize("name", ["robots that fly off", "robots that touch the end"])
def test_a_missing_event_of_a_robot_that_crosses_an_end_is_found_although_all_other_messages_fit(name: str) -> None:
    """Steps that are recomputed side by side have no events, so that of a crossing must not be among them."""
    scenario, bag = whole(*WORLDS[name])
    crossings = [n for n, s in enumerate(bag) if isinstance(s.message, msg.SwarmEvent) and crossing_of(s.message)]
    assert crossings
    for n in crossings[:3]:
        event = bag[n].message
        verification = LockstepVerification(scenario)
        take(verification, in_chunks(scenario, [*bag[:n], *bag[n + 1 :]], Random(0), [len(bag)]))
        verification.finish()
        difference = verification.result.difference
        assert place(difference) == ("swarm/events", event.step, agent_id_of(event), "message")


class Nudged(Agent):
    """A robot that adds one unit in the last place to one command, and goes on by the law."""

    def __init__(self, config: AgentConfig) -> None:
        super().__init__(config)
        controller = self._body._controller  # noqa: SLF001 - there is no other way to its law
        law = controller.follow

        def nudged(p: float, v: float, abstract: msg.AbstractState, *others: Any) -> float:
            command = law(p, v, abstract, *others)
            return math.nextafter(command, math.inf) if abstract.step == 30 else command

        controller.follow = nudged


def otherwise(**settings: object) -> Callable[[AgentConfig], Agent]:
    return lambda config: Agent(replace(config, **settings))  # type: ignore[arg-type]


OTHER_GAINS = replace(configure.agent_configs(builtin("pd_het_4"))[0].gains, kp=(10.0, 10.000001))


@pytest.mark.parametrize(
    ("make", "robot", "step", "field"),
    [
        (Nudged, 1, 31, "command"),
        (Nudged, 3, 31, "command"),
        (otherwise(gains=OTHER_GAINS), 3, 1, "command"),
        (otherwise(mass=0.6763), 3, 0, "mass"),
        (otherwise(kind=msg.Kind.SINGLE_INTEGRATOR, damping=0.0), 3, 0, "kind"),
        (otherwise(feels_gravity=True), 3, 1, "velocity"),
    ],
)
def test_a_robot_that_is_not_the_one_of_the_scenario_is_found_although_all_that_follows_fits(
    monkeypatch: pytest.MonkeyPatch, make: Callable[[AgentConfig], Agent], robot: int, step: int, field: str
) -> None:
    scenario = world("pd_het_4", SHORT)
    with monkeypatch.context() as patch:
        patch.setattr(simulation, "Agent", lambda config: (make if config.agent_id == robot else Agent)(config))
        bag = record(scenario)
    difference = first_difference(scenario, bag)
    assert place(difference) == ("swarm/agent_state", step, robot, field)
    if make is Nudged:
        assert difference.a == math.nextafter(float(str(difference.b)), math.inf)
        assert verify(scenario, bag, tolerance=1e-9).difference is None


# Robots that are dropped, and runs that end early


def test_a_robot_that_was_dropped_is_taken_from_the_record() -> None:
    """To others it is as if the robot had been killed by plan, but the observer always tells who stands."""
    bag = record(world("pd_het_4", SHORT, "faults=[{at: 0.29, kind: kill, agent: 2}]"), ALWAYS)
    (index,) = (n for n, s in enumerate(bag) if s.topic is msg.EVENTS)
    bag[index] = changed(bag[index], detail=SILENT)
    scenario = world("pd_het_4", SHORT, "lockstep.on_stall=drop")
    assert verify(scenario, bag).difference is None
    elsewhere = [*bag[:index], changed(bag[index], value=0.0), *bag[index + 1 :]]
    assert place(first_difference(scenario, elsewhere)) == ("swarm/events", 30, 2, "value")
    unannounced = bag[:index] + bag[index + 1 :]
    assert place(first_difference(scenario, unannounced)) == ("swarm/agent_state", 30, 2, "message")
    undivided = [stored for stored in bag if stored.topic is not msg.STANDING]
    assert place(first_difference(scenario, undivided)) == ("swarm/standing", 1, None, "message")
    assert place(first_difference(world("pd_het_4", SHORT), bag)) == ("swarm/standing", 1, None, "message")
    assert place(first_difference(world("pd_het_4", SHORT), undivided)) == ("swarm/agent_state", 30, 2, "message")


def test_a_bag_that_says_so_may_break_off_within_its_last_step() -> None:
    scenario, bag = whole("pd_het_4", SHORT)
    begin = next(n for n, s in enumerate(bag) if s.message.step == 40)
    for length in range(9):
        result = verify(scenario, bag[: begin + length], whole=False)
        assert result.difference is None
        assert (result.steps, result.messages) == (40 + (length == 8), begin + length)
        assert result.digest == verify(scenario, bag[: begin + 8 * (length == 8)], whole=False).digest
    for n in range(begin, begin + 7):  # what is there of it is still compared
        part = [*bag[:n], changed(bag[n], stamp=1), *bag[n + 1 : begin + 7]]
        found_there = first_difference(scenario, part, whole=False)
        assert place(found_there) == (bag[n].topic.name, 40, agent_id_of(bag[n].message) or None, "stamp")
    for n in (begin + 1, begin + 4, begin + 6):  # a hole is no end
        hole = [*bag[:n], *bag[n + 1 : begin + 8]]
        assert place(first_difference(scenario, hole, whole=False))[:2] == (bag[n].topic.name, 40)
        before = [*bag[: n - 8], *bag[n - 7 : begin + 5]]
        assert place(first_difference(scenario, before, whole=False))[:2] == (bag[n].topic.name, 39)
    assert place(first_difference(scenario, bag[: begin + 2])) == ("swarm/agent_state", 40, 3, "message")
    unsaid = first_difference(scenario, bag[: begin + 8])
    assert place(unsaid) == ("swarm/agent_state", 41, None, "message")
    assert "without giving a reason" in unsaid.reason


def test_a_robot_that_takes_the_name_of_another_is_named_whatever_the_clock_of_the_other() -> None:
    named = ("pd_het_4", SHORT, "faults=[{kind: clock_offset, agent: 4, offset: 0.05}]")
    bag = list(recorded(*named))
    index = next(n for n, s in enumerate(bag) if s.message.step == 9 and agent_id_of(s.message) == 1)
    bag[index] = changed(bag[index], agent_id=4)
    difference = first_difference(world(*named), bag)
    assert place(difference) == ("swarm/agent_state", 9, 1, "agent_id")
    assert (difference.a, difference.b) == (4, 1)


def test_a_run_that_had_to_fail_cannot_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    named = ("pd_het_4", SHORT, "plane.angle=1.45", "plane.angular_velocity=5")
    scenario = world(*named)
    steps = []
    with pytest.raises(RunError, match=r"1\.5 rad"):
        steps.extend(Simulation(scenario).steps())
    with monkeypatch.context() as patch:
        patch.setattr(desired_state, "STEEPEST", 10.0)
        bag = record(scenario)
    difference = first_difference(scenario, bag)
    assert (difference.topic, difference.field, difference.b) == (msg.DESIRED_ABSTRACT_STATE.name, "message", None)
    assert "1.5 rad" in difference.reason
    assert difference.step is not None
    before = [stored for stored in bag if stored.message.step < difference.step]
    assert verify(scenario, before, whole=False).difference is None


def test_log_times_signs_of_zero_and_not_a_number_are_bits_too() -> None:
    scenario, bag = whole("pd_si_4", SHORT)
    index = find(bag, msg.PLANE_STATE, 7)
    late = first_difference(scenario, [*bag[:index], bag[index]._replace(time=80_000_000), *bag[index + 1 :]])
    assert place(late) == ("plane/state", 7, None, "log_time")
    assert (late.a, late.b) == (80_000_000, 70_000_000)
    index = find(bag, msg.AUXILIARY_STATE, 3)  # single integrators only: D0 is 0
    for value in (-0.0, math.nan, -math.inf):
        bag[index] = changed(bag[index], d0=value)
        difference = first_difference(scenario, bag)
        assert place(difference) == ("swarm/auxiliary_state", 3, None, "d0")
        assert repr(difference.a) == repr(value)
        if value:
            assert difference.to_dict("recorded", "recomputed")["recorded"] == repr(value)
            assert place(first_difference(scenario, bag, tolerance=0.1)) == place(difference)
