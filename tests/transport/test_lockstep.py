"""Whatever the transport does to a swarm in lockstep, the run ends, and each of its bits is that of the simulation.

The runs are short ones of few robots that together have everything of lockstep in them.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from functools import cache
from random import Random
from types import MappingProxyType
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from tests.swarmabs_core.helpers import builtin, singly
from tests.transport.network import Act, Script, script, scripts
from tests.transport.swarm import AGENTS, FROZEN, LONGEST_RUN, Cast, Swarm

from swarmabs_bag.run.step import Step
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE, RECORDER
from swarmabs_config.scenario.steered import as_planned
from swarmabs_core.behaviours import Agent, Request
from swarmabs_core.errors import InputError
from swarmabs_core.membership import SILENT, Change, ChangeKind
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, Action, Message, Messages, Topic
from swarmabs_core.nodes import agent_name
from swarmabs_core.steering import STEERER
from swarmabs_ros.lockstep import LONGEST, Repeater
from swarmabs_run.run import RunOptions
from swarmabs_run.simulation import Simulation

SEEDS = 8
"""Number of scripts by which the everyday tests run each case."""
STALL = 5.0
"""Time, s, after which a node reports that it waits, as the parameter `stall_timeout` is by default."""
LENGTH = 25


class Case(NamedTuple):
    """A run: what its scenario says beyond three robots and five steps, and how it is run."""

    overrides: tuple[str, ...] = ()
    options: RunOptions = RunOptions()
    changed: Mapping[str, Mapping[str, object]] = MappingProxyType({})


PACKED = RunOptions(packed=True)
_EACH_ROBOT = Case(("coordination=each_robot",))
_RING = (*_EACH_ROBOT.overrides, "links={type: ring, loss: 0.3, sensing: [1, 2]}")


def _faults(*faults: str) -> Case:
    return Case((f"faults=[{', '.join(f'{{{fault}}}' for fault in faults)}]",))


CASES = {
    "plain": Case(),
    "packed": Case(options=PACKED),
    "plane watched, packed": Case(("observer={type: parent_response}",), PACKED),
    "little credit": Case(
        ("duration=0.3",),
        changed={CONTROLLER: {"recording_window": 18}}
        | {name: {"repeat_steps": 20} for name in (PLANE, OBSERVER, *map(agent_name, (1, 2, 3)))},
    ),
    "noise and lag": Case(
        ("plane.sensor={noise: [1.0e-4, 1.0e-3]}", "swarm.sensor={noise: [1.0e-5, 1.0e-4]}", "swarm.actuator_lag=0.01")
    ),
    "plane felt": Case(("plane.robot_gravity=true",)),
    "plane watched": Case(("observer={type: parent_response}",)),
    "adaptive": Case(("controller={type: arise}",)),
    "loss": _faults("kind: loss, probability: 0.5"),
    "delay": _faults("kind: delay, steps: 2"),
    "duplication": _faults("kind: duplication, probability: 0.5"),
    "reordering": _faults("kind: reordering, probability: 0.6, steps: 3"),
    "clock offset": _faults("kind: clock_offset, agent: 2, offset: -0.5, from: 0.02, to: 0.04"),
    "lie": _faults("kind: lie, agent: 1, position_offset: 0.02, mass_factor: 0.8"),
    "kill": _faults("kind: kill, agent: 2, at: 0.02"),
    "freeze": _faults("kind: freeze, agent: 1, at: 0.03"),
    "leave": _faults("kind: leave, agent: 3, at: 0.02"),
    "remove": _faults("kind: remove, agent: 3, at: 0.02"),
    "join": _faults("kind: join, agent: 3, at: 0.03"),
    "join and leave in one step": _faults("kind: join, agent: 3, at: 0.03", "kind: leave, agent: 3, at: 0.03"),
    "reference": _faults("kind: reference, offset: 0.1, at: 0.02, until: 0.04"),
    "disturbance": _faults("kind: disturbance, torque: 0.2, at: 0.02"),
    "each robot": _EACH_ROBOT,
    "each robot, in a ring that loses messages, with a join and a kill": Case(
        (*_RING, "faults=[{kind: join, agent: 3, at: 0.02}, {kind: kill, agent: 2, at: 0.03}]")
    ),
    "each robot, of which one hears the plane, steered": Case(
        (*_EACH_ROBOT.overrides, "links={sensing: [2]}"), RunOptions(steered=True)
    ),
    "several, packed": _faults(
        "kind: lie, agent: 2, position_offset: 0.1",
        "kind: kill, agent: 2, at: 0.03",
        "kind: loss, probability: 0.3",
        "kind: duplication, probability: 0.5",
        "kind: join, agent: 3, at: 0.02",
    )._replace(options=PACKED),
}

_CHANGES = _faults("kind: kill, agent: 1, at: 0.03", "kind: join, agent: 3, at: 0.02")
_ASKED_FOR = _faults("kind: join, agent: 3, at: null", "kind: reference, offset: 0.05, at: 0.02")
_STEERABLE = (*_ASKED_FOR.overrides, "lockstep.on_stall=drop")
DROPPING = {
    "drop": Case(("lockstep.on_stall=drop",)),
    "drop, packed": Case(("lockstep.on_stall=drop",), PACKED),
    "drop, each robot": Case((*_EACH_ROBOT.overrides, "lockstep.on_stall=drop")),
    "drop, with a planned join and kill": Case((*_CHANGES.overrides, "lockstep.on_stall=drop")),
}
"""Runs of which more is known only when they are over, as of those that are steered."""
STEERED = {
    "steered": Case(_STEERABLE, RunOptions(steered=True)),
    "steered, packed": Case(_STEERABLE, RunOptions(steered=True, packed=True)),
    "steered, each robot": Case((*_EACH_ROBOT.overrides, *_STEERABLE), RunOptions(steered=True)),
}


@cache
def cast_of(name: str) -> Cast:
    case = (CASES | DROPPING | STEERED)[name]
    scenario = builtin("pd_het_4", f"swarm.agents=[{', '.join(AGENTS)}]", "duration=0.05", *case.overrides).resolved()
    return Cast(scenario, case.options, case.changed)


@cache
def expected(name: str) -> tuple[list[object], dict[Topic, set[bytes]]]:
    """Return what is stored of each step of a case, and what is published, as the simulation in one process has it."""
    steps = singly(Simulation(cast_of(name).scenario).steps())
    return stored(steps), payloads(steps)


def stored(steps: Iterable[Step]) -> list[object]:
    """Return what is stored of each step, with the events that came after it."""
    main, events = defaultdict[int, list[object]](list), defaultdict[int, list[tuple[int, bytes]]](list)
    for step in steps:
        for topic, time, data in step.stored():
            if topic is EVENTS:
                events[step.step].append((time, data))
            else:
                main[step.step].append((topic, time, data))
    return [(number, messages, sorted(events[number])) for number, messages in main.items()]


def payloads(steps: Iterable[Step]) -> dict[Topic, set[bytes]]:
    by_topic = defaultdict[Topic, set[bytes]](set)
    for step in steps:
        for record in step.records:
            by_topic[record.topic].add(record.payload)
    return by_topic


def problem_of(name: str, doings: Script, until: float = LONGEST_RUN) -> str:
    """Run a case; say what is wrong with it, empty if nothing is."""
    swarm = Swarm(cast_of(name), doings)
    if not swarm.run(until):
        waiting = {node.name: node.spec.behaviour.missing() for node in swarm.nodes.values() if node.alive}
        return f"does not end: {swarm.problems or waiting}"
    steps, wanted = expected(name)
    if stored(swarm.recorded) != steps:
        return "other messages are recorded than the simulation has"
    said = defaultdict[Topic, set[bytes]](set)
    for _, topic, data in swarm.published:
        said[topic].add(data)
    if wrong := [topic.name for topic in (*MAIN_TOPICS, EVENTS) if said[topic] != wanted[topic]]:
        return f"other messages are published than the simulation has: {wrong}"
    stands_still = FROZEN * sum(act in {Act.FREEZE, Act.LATE} for _, act, _ in doings)
    reported = {n.name: n.reports.troubles for n in swarm.nodes.values() if n.reports.troubles}
    if reported and stands_still < STALL:
        return f"something is reported: {reported}"
    return ""


@pytest.mark.parametrize("name", CASES)
def test_each_interleaving_gives_the_bits_of_the_simulation(name: str) -> None:
    assert [(seed, problem) for seed in range(SEEDS) if (problem := problem_of(name, script(seed, LENGTH)))] == []


@pytest.mark.full
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", CASES)
def test_many_more_interleavings_give_the_bits_of_the_simulation(name: str) -> None:
    assert [(seed, problem) for seed in range(SEEDS, 4000) if (problem := problem_of(name, script(seed, 40)))] == []


@pytest.mark.full
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", CASES)
@given(doings=scripts())
@settings(max_examples=50, derandomize=True, database=None, deadline=None)
def test_no_short_interleaving_gives_others(name: str, doings: Script) -> None:
    assert problem_of(name, doings) == ""


WAITING = {
    "agent_002": {(PLANE, "agent 2"), (OBSERVER, "agent 2")},
    PLANE: {(CONTROLLER, PLANE)},
    OBSERVER: {("agent_001", "swarm/abstract_state"), ("agent_003", "swarm/auxiliary_state")},
    CONTROLLER: {("agent_001", "swarm/desired_abstract_state"), ("agent_003", "swarm/desired_abstract_state")},
}
"""By the node that dies: who waits for it, and for what."""


@pytest.mark.parametrize("name", WAITING)
@pytest.mark.parametrize("seed", [1, 4])
def test_who_dies_without_a_word_is_named_by_those_who_have_come_least_far(name: str, seed: int) -> None:
    swarm = Swarm(cast_of("plain"), script(seed, LENGTH))
    swarm.run_turns(10 + 10 * seed)
    swarm.kill(name)
    assert not swarm.run(30.0)
    assert not swarm.problems
    stalls = {who: stall for who, stall in swarm.stalls().items() if who != RECORDER}  # which may lack older messages
    first = min(stall["step"] for stall in stalls.values())
    named = {(who, whom) for who, stall in stalls.items() for whom in stall["missing"] if stall["step"] == first}
    assert named & WAITING[name]
    assert {whom for _, whom in named if whom.startswith("agent")} <= {"agent 2"} & {whom for _, whom in WAITING[name]}


def test_who_waits_for_the_recorder_names_it() -> None:
    swarm = Swarm(cast_of("little credit"))
    swarm.kill(RECORDER)
    assert not swarm.run(20.0)
    assert swarm.stalls()[CONTROLLER]["missing"] == (RECORDER,)


@pytest.mark.parametrize("name", ["drop", "drop, packed"])
def test_a_run_that_drops_who_is_silent_is_that_of_a_plan_with_its_death(name: str) -> None:
    """It ends, unless the last word of the dead has reached some of those who must know it, and not all.

    If all but the observer know it from the observer, it always ends.
    """
    cast_, ended = cast_of(name), 0
    for seed in range(8):
        swarm = Swarm(cast_, script(seed, LENGTH))
        while swarm.nodes[OBSERVER].spec.behaviour.missing()[0] == 0:
            swarm.step()
        swarm.run_turns(6 * seed)
        swarm.kill("agent_002")
        if swarm.run(30.0):
            ended += 1
            assert_planned(swarm, cast_)
        elif swarm.problems:
            assert "it ended when the plane had heard it and the observer had not" in str(swarm.problems[PLANE])
        else:
            stalls = swarm.stalls()
            assert ("agent 2",) in (stalls[RECORDER]["missing"], stalls[PLANE]["missing"])
    assert ended == 8 if cast_.packed else ended > 4


ASKED = (
    Request(Action.ADD, 3),
    Request(Action.REFERENCE, 0, 0.1),
    Request(Action.DISTURBANCE, 0, 0.2),
    Request(Action.DISTURBANCE, 0, 0.3, steps=2),
    Request(Action.KILL, 2),
    Request(Action.REMOVE, 1),
    Request(Action.FREEZE, 3),
)


@pytest.mark.parametrize("name", STEERED)
@pytest.mark.parametrize("seed", range(6))
def test_a_steered_run_is_that_of_a_plan_with_what_was_ordered(seed: int, name: str) -> None:
    draw = Random(seed)
    cast_ = cast_of(name)
    swarm = Swarm(cast_, script(seed, LENGTH))
    for request in draw.sample(ASKED, draw.randint(1, 3)):
        swarm.run_turns(draw.randint(0, 60))
        with suppress(InputError):  # such as of a robot that is not there
            swarm.steerer.ask(request)
    assert swarm.run()
    assert_planned(swarm, cast_)


@pytest.mark.parametrize("name", STEERED)
def test_a_pause_changes_nothing_and_drops_nobody(name: str) -> None:
    """It is longer than the stall timeout, after which silent robots are dropped."""
    cast_ = cast_of(name)
    plain = payloads(Simulation(cast_.scenario).steps())
    for seed in range(4):
        swarm = Swarm(cast_, script(seed, LENGTH))
        while swarm.steerer.step <= seed % 4:
            swarm.step()
        swarm.steerer.pause(paused=True)
        assert not swarm.run(3.0 * cast_.scenario.lockstep.stall_timeout)
        assert not swarm.problems
        assert swarm.stalls()[PLANE]["missing"] == (STEERER,)
        swarm.steerer.pause(paused=False)
        assert swarm.run()
        assert payloads(swarm.recorded) == plain


def assert_planned(swarm: Swarm, cast_: Cast) -> None:
    """Check a run against the simulation of what had been planned if all had been known before."""
    steps = swarm.recorded
    events = [event for step in steps for event in step.events]
    ends = [Change(e.step - 1, e.agent_id, ChangeKind.KILL) for e in events if e.detail == SILENT]
    planned = singly(Simulation(as_planned(cast_.scenario, events, ends=ends)).steps())
    for topic in MAIN_TOPICS:
        assert payloads(steps)[topic] == payloads(planned)[topic], topic.name


def silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no loop repeat itself."""
    monkeypatch.setattr(Repeater, "due", lambda *_: 0)
    monkeypatch.setattr(Repeater, "wait", lambda *_: LONGEST)


def credulous(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let robots take an old broadcast for one of their step."""
    handle = Agent.handle

    def handling(self: Agent, message: Message) -> Messages:
        return handle(self, message._replace(step=max(message.step, self.missing()[0])))

    monkeypatch.setattr(Agent, "handle", handling)


@pytest.mark.parametrize("wrong", [silent, credulous])
def test_loop_and_node_errors(wrong: Callable[[pytest.MonkeyPatch], None], monkeypatch: pytest.MonkeyPatch) -> None:
    wrong(monkeypatch)
    assert problem_of("plain", []) == "", "nothing is wrong as long as the transport is good"
    assert any(problem_of("plain", script(seed, LENGTH), until=5.0) for seed in range(20))
