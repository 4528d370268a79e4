"""States of a step as one table against the same states one after the other, bit for bit."""

from collections.abc import Callable
from functools import cache
from math import inf, nan
from random import Random
from typing import Any

import numpy as np
import pytest
from tests.swarmabs_bag.test_systems import BEAM, LIFT, SHEET
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state, builtin, singly

from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_core import messages as msg
from swarmabs_core.arrays import canonical_table, layout_of
from swarmabs_core.behaviours import Agent, Observer, Parent
from swarmabs_core.behaviours.base import OtherSystemError
from swarmabs_core.behaviours.packed import PackedObserver, PackedParent
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import SwarmabsError
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import PLANE_STATE, SwarmStates
from swarmabs_core.models import ObserverConfig, PlaneConfig
from swarmabs_run.simulation import Simulation

pytestmark = pytest.mark.usefixtures("systems")


@pytest.fixture(autouse=True, params=[1, 1000])
def few(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Take all states as tables, or none of them."""
    monkeypatch.setattr("swarmabs_core.behaviours.packed.FEW", request.param)
    return int(request.param)


FAULTS = (
    "{at: 0.05, kind: leave, agent: 1}",
    "{at: 0.08, kind: join, agent: 2}",
    "{at: 0.11, kind: kill, agent: 3}",
    "{kind: loss, probability: 0.3}",
    "{kind: clock_offset, agent: 4, offset: -0.5, from: 0.02, to: 0.04}",
)
OVERRIDES = {
    "faulty": ("pd_di_4", f"faults=[{', '.join(FAULTS)}]"),
    "falsified": ("pd_het_4", "faults=[{kind: lie, agent: 1, position_offset: 0.02}, {kind: drive_failure, agent: 2}]"),
    "watched": ("pd_het_4", "observer={type: parent_response}"),
    "beyond the end": ("pd_het_4", "plane.length=0.3", "plane.end_stop=0.11", "swarm.actuator_lag=0.01"),
    "large": ("arise_het_20",),
    "heights": ("pd_het_4", *(f"swarm.agents.{n}.center_height={0.02 * n}" for n in range(4)), f"faults=[{FAULTS[2]}]"),
}
SYSTEMS = {"sheet": SHEET, "beam": BEAM, "lift": LIFT}


@cache
def run(name: str) -> tuple[Any, list[Step]]:
    """Return a scenario and its steps."""
    if name in SYSTEMS:
        scenario: Any = parse_scenario(SYSTEMS[name]).resolved()
    else:
        base, *overrides = OVERRIDES[name]
        scenario = builtin(base, "duration=0.2", *overrides).resolved()
    return scenario, singly(Simulation(scenario).steps())


def dirty(payload: bytes) -> bytes:
    """Return a payload with other bytes where its padding is."""
    return payload[:2] + b"\xaa\xbb" + payload[4:22] + b"\xcc" * 6 + payload[28:]


def single(node: Observer, robot: msg.Topic, payloads: list[bytes]) -> list[msg.Message]:
    return [answer for data in payloads for answer in node.handle(decode(robot.message, data))]


def together(node: PackedObserver, robot: msg.Topic, payloads: list[bytes]) -> list[msg.Message]:
    found = [answer for data in payloads for answer in node.hear_all(robot, [data])]
    node.missing()  # the last ones may be repeats, which are kept for the next step
    return found


@pytest.mark.parametrize("name", [*OVERRIDES, *SYSTEMS])
def test_packed_nodes_answer_like_those_that_take_one_state_after_the_other(name: str) -> None:
    scenario, steps = run(name)
    draw, robot = Random(name), scenario.family.robot
    watching = configure.observer_config(scenario)
    observers = Observer(watching), PackedObserver(watching)
    parents = Parent(configure.parent_config(scenario)), PackedParent(configure.parent_config(scenario))
    assert parents[0].start() == parents[1].start()
    for step in steps:
        payloads = [record.payload for record in step.records if record.topic is robot]
        told = draw.sample(payloads, len(payloads))
        if draw.random() < 0.3:
            told = [*draw.sample(payloads, 2), *told, *draw.sample(payloads, 1)]
        if draw.random() < 0.2:
            told[0] = dirty(told[0])
        expected, found = single(observers[0], robot, told), together(observers[1], robot, told)
        if PLANE_STATE in observers[0].awaits():
            expected += observers[0].handle(step.parent)
            found += observers[1].handle(step.parent)
        (packed,) = (answer for answer in found if isinstance(answer, SwarmStates))
        assert packed == SwarmStates(step.step * scenario.step_ns, step.step, b"".join(payloads))
        assert list(map(encode, expected)) == [encode(answer) for answer in found if answer is not packed]
        events = [event for event in step.events if event.kind in {msg.EventKind.DEAD, msg.EventKind.LEFT}]
        moved = [answer for event in events for answer in parents[0].handle(event)]
        moved += [answer for state in step.states() for answer in parents[0].handle(state)]
        taken = [answer for event in events for answer in parents[1].handle(event)]
        taken += [*parents[1].handle(packed), *parents[1].handle(packed)]
        assert list(map(encode, moved)) == list(map(encode, taken))
        assert moved


def test_no_single_state_of_an_ordinary_step_is_decoded(few: int, monkeypatch: pytest.MonkeyPatch) -> None:
    if few > 1:
        return
    scenario, steps = run("large")
    observer = PackedObserver(configure.observer_config(scenario))
    parent = PackedParent(configure.parent_config(scenario))
    for step in steps[:5]:
        payloads = [record.payload for record in step.records if record.topic is msg.AGENT_STATE]
        packed, *sums = together(observer, msg.AGENT_STATE, payloads[::-1])
        assert [encode(answer) for answer in sums] == [step.records[place].payload for place in (-3, -2)]
        assert encode(parent.handle(packed)[-1]) == step.records[-4].payload
        monkeypatch.setattr("swarmabs_core.behaviours.packed.decode", None)


VALUES = (0.0, -0.0, inf, -inf, nan, 1e200, -1e200, 5e-324, 0.3, -0.7)


@pytest.mark.parametrize("seed", range(30))
def test_any_numbers_give_the_same_bits(seed: int) -> None:
    draw = Random(seed)
    ids = tuple(range(1, draw.choice((2, 5, 33))))
    schedule = (Change(1, ids[-1], ChangeKind.KILL),) if seed % 2 and len(ids) > 1 else ()
    config = ObserverConfig(PERIOD_NS, members=ids, schedule=schedule)
    observers = Observer(config), PackedObserver(config)
    body = PlaneConfig(PERIOD_NS, members=ids, schedule=schedule)
    parents = Parent(body), PackedParent(body)
    for step in range(4):
        there = ids[: len(ids) - bool(schedule and step > 1)]
        states = [
            agent_state(
                i,
                step,
                kind=draw.choice((msg.Kind.SINGLE_INTEGRATOR, msg.Kind.DOUBLE_INTEGRATOR)),
                status=draw.choice((msg.Status.ACTIVE, msg.Status.ACTIVE, msg.Status.SAFE_STOP)),
                **{
                    name: draw.choice(VALUES) if draw.random() < 0.1 * (seed > 9) else draw.uniform(-0.4, 0.4)
                    for name in ("mass", "damping", "position", "velocity")
                },
            )
            for i in there
        ]
        payloads = list(map(encode, states))
        expected = single(observers[0], msg.AGENT_STATE, payloads)
        found = together(observers[1], msg.AGENT_STATE, payloads)
        (packed,) = (answer for answer in found if isinstance(answer, SwarmStates))
        assert [encode(answer) for answer in found if answer is not packed] == list(map(encode, expected))
        moved = outcome(lambda states=states: [answer for state in states for answer in parents[0].handle(state)])
        assert moved == outcome(lambda packed=packed: parents[1].handle(packed))
        if isinstance(moved, tuple):  # the run has failed
            return


def outcome(act: Callable[[], Any]) -> object:
    """Return the bytes of what is answered, or the error."""
    try:
        return list(map(encode, act()))
    except SwarmabsError as error:
        return type(error), str(error)


STATES = [agent_state(i, 0, position=0.1 * i) for i in range(1, 5)]


@pytest.mark.parametrize(
    "wrong",
    [
        agent_state(7),
        agent_state(2, 1),
        agent_state(2, position=0.3),
        agent_state(2)._replace(stamp=-1),
        encode(STATES[1])[:-1],
        encode(STATES[1]) + b"\x00" * 4,
        b"\x00\x03" + encode(STATES[1])[2:],
        encode(STATES[1])[:16] + b"plant" + encode(STATES[1])[21:],
    ],
)
@pytest.mark.parametrize("place", range(4))
def test_what_is_refused_is_refused_with_the_same_words(wrong: msg.AgentState | bytes, place: int) -> None:
    payloads = [*map(encode, STATES)]
    payloads.insert(place, wrong if isinstance(wrong, bytes) else encode(wrong))
    config = ObserverConfig(PERIOD_NS, members=(1, 2, 3, 4))
    observers = Observer(config), PackedObserver(config)
    expected = outcome(lambda: single(observers[0], msg.AGENT_STATE, payloads))
    found = outcome(lambda: together(observers[1], msg.AGENT_STATE, payloads))
    if isinstance(expected, tuple):
        assert found == expected
    else:
        assert found == [encode(SwarmStates(0, 0, b"".join(map(encode, STATES)))), *expected]


def test_states_of_another_system_are_refused_by_both_nodes() -> None:
    scenario, steps = run("beam")
    robot = scenario.family.robot
    states = [state._replace(system=5) for state in steps[0].states()]
    payloads = list(map(encode, states))
    for node in (
        lambda: together(PackedObserver(configure.observer_config(scenario)), robot, payloads),
        lambda: PackedParent(configure.parent_config(scenario)).handle(SwarmStates(0, 0, b"".join(payloads))),
    ):
        assert "its parent system has another description" in str(outcome(node))
    *_, desired = steps[0].records
    abstract, auxiliary = (record.message for record in steps[0].records[-3:-1])
    packed = msg.SwarmBroadcast(0, 0, abstract._replace(system=5), auxiliary, desired.message)
    agent = Agent(configure.agent_configs(scenario)[0], packed=True)
    assert outcome(lambda: agent.handle(packed))[0] is OtherSystemError


def test_a_robot_that_stays_silent_is_missing_and_one_that_repeats_itself_is_not_counted_twice() -> None:
    config = ObserverConfig(PERIOD_NS, members=(1, 2, 3, 4))
    node = PackedObserver(config)
    for number in (1, 2, 1, 1, 2):
        assert node.hear_all(msg.AGENT_STATE, [encode(STATES[number])]) == ()
    assert node.missing() == (0, ("agent 1", "agent 4"))
    assert node.silent_agents() == (1, 4)
    events_and_sums = node.drop((1, 4), "silent")
    assert [type(answer) for answer in events_and_sums] == [
        *(msg.SwarmEvent, msg.SwarmEvent, SwarmStates, msg.AbstractState, msg.AuxiliaryState)
    ]


def test_a_leaving_robot_ends_in_the_same_step() -> None:
    config = ObserverConfig(PERIOD_NS, members=(1, 2, 3, 4))
    observers = Observer(config), PackedObserver(config)
    parents = (
        Parent(PlaneConfig(PERIOD_NS, members=(1, 2, 3, 4))),
        PackedParent(PlaneConfig(PERIOD_NS, members=(1, 2, 3, 4))),
    )
    for step in range(3):
        there = [state for state in STATES if step < 2 or state.agent_id != 3]
        states = [state._replace(step=step, stamp=step * PERIOD_NS) for state in there]
        if step == 1:
            states[2] = states[2]._replace(status=msg.Status.LEFT)
        payloads = list(map(encode, states))
        found = together(observers[1], msg.AGENT_STATE, payloads)
        (packed,) = (answer for answer in found if isinstance(answer, SwarmStates))
        assert single(observers[0], msg.AGENT_STATE, payloads) == [answer for answer in found if answer is not packed]
        assert [a for s in states for a in parents[0].handle(s)] == list(parents[1].handle(packed))


def test_joined_payloads_are_a_table_only_if_they_are_canonical_and_alike() -> None:
    payloads = list(map(encode, STATES))
    table = canonical_table(msg.AGENT_STATE, b"".join(payloads))
    assert table is not None
    assert table["agent_id"].tolist() == [1, 2, 3, 4]
    layout = layout_of(msg.AGENT_STATE, payloads[0])
    late = np.frombuffer(payloads[1], layout).copy()
    late["nanosec"] = 10**9
    for wrong in (dirty(payloads[1]), b"\x00\x03" + payloads[1][2:], payloads[1][:-1], late.tobytes()):
        assert canonical_table(msg.AGENT_STATE, b"".join([payloads[0], wrong, *payloads[2:]])) is None
    assert canonical_table(msg.AGENT_STATE, b"") is None
    robot = msg.RobotState(0, 0, 5, msg.NEVER, 1, 3, 1, (0.5, -1.0), (0.25, 0.0), (0.0, 0.0), (70.0,))
    other = robot._replace(constants=(70.0, 1.0))
    assert canonical_table(msg.ROBOT_STATE, encode(robot) * 2) is not None
    assert canonical_table(msg.ROBOT_STATE, encode(robot) + encode(other)) is None
