"""Steering while a run goes: whatever comes when, and whatever gets lost, it could have been planned."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

import pytest
from tests.swarmabs_core.helpers import builtin, digest

from swarmabs_bag.recording import RecordedStep, RunCollector
from swarmabs_config import configure
from swarmabs_config.scenario.steered import as_planned
from swarmabs_core.behaviours import (
    Agent,
    Controller,
    Decision,
    Observer,
    Plane,
    Request,
    Steered,
    SteeringConfig,
    SteeringController,
)
from swarmabs_core.behaviours.base import ConflictError, StepAheadError
from swarmabs_core.errors import InputError
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    EVENTS,
    PLANE_STATE,
    STEERING,
    TOPIC_OF,
    Action,
    EventKind,
    PlaneState,
    Steering,
    SwarmEvent,
)
from swarmabs_core.record import Record
from swarmabs_core.steering import DISTURBANCE, REFERENCE, StepChange
from swarmabs_run.simulation import Simulation

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.behaviours import Behaviour
    from swarmabs_core.messages import Message, Topic

REPEATED = 100
"""Steps whose messages are sent again when nothing moves: all, as nobody waits for the recorder here."""


@dataclass
class Node:
    """A state machine with what has arrived for it, and what it has sent."""

    behaviour: Behaviour
    hears: tuple[Topic, ...]
    arrived: dict[Topic, deque[Message]] = field(default_factory=dict)
    sent: list[Message] = field(default_factory=list)
    dead: bool = False

    def ready(self) -> list[Topic]:
        return [] if self.dead else [topic for topic in self.behaviour.awaits() if self.arrived.get(topic)]


class Swarm:
    """All nodes of a steered run, with a network that delivers in any order and loses messages."""

    def __init__(self, scenario: Scenario, seed: int, *, packed: bool) -> None:
        self.random = Random(seed)
        self.scenario = scenario
        self.controller = SteeringController(steering_config(scenario))
        observer = Steered(Observer(configure.observer_config(scenario)))
        plane = Steered(Plane(configure.plane_config(scenario)))
        config = configure.controller_config(scenario, recording_window=0)
        controller = Steered(Controller(config, configure.parent_controller(scenario), packed=packed))
        observed = (ABSTRACT_STATE, AUXILIARY_STATE) if packed else ()
        self.nodes = [
            Node(self.controller, (PLANE_STATE, EVENTS)),
            Node(observer, (AGENT_STATE, STEERING)),
            Node(plane, (AGENT_STATE, EVENTS, STEERING)),
            Node(controller, (PLANE_STATE, STEERING, *observed)),
        ]
        self.robots = {}
        for agent_config in configure.agent_configs(scenario):
            robot = Agent(agent_config, packed=packed, steered=True)
            self.robots[agent_config.agent_id] = Node(robot, robot.needs)
        self.nodes += self.robots.values()
        self.collector = RunCollector(
            configure.members(scenario), configure.schedule(scenario), scenario.steps, steered=True
        )
        self.steps: list[RecordedStep] = []
        self.decisions: list[Decision] = []

    def publish(self, message: Message) -> None:
        topic = TOPIC_OF[type(message)]
        for node in self.nodes:
            if topic in node.hears and self.random.random() > 0.03:
                node.arrived.setdefault(topic, deque()).append(message)
        if self.random.random() > 0.03:
            if isinstance(message, Steering):
                self.steps += self.collector.steer(message)[1]
            elif topic.name != "swarm/broadcast":
                self.steps += self.collector.add(Record.of(message))

    def send(self, node: Node, messages: tuple[Message, ...]) -> None:
        for message in messages:
            node.sent.append(message)
            self.publish(message)

    def run(self, wishes: float) -> None:
        """Run to the end; somebody wants something with a probability before each delivery."""
        for node in self.nodes:
            self.send(node, node.behaviour.start())
        while not self.collector.finished:
            if self.random.random() < wishes:
                self.wish()
            ready = [(node, topic) for node in self.nodes for topic in node.ready()]
            if not ready:
                self.repeat()
                continue
            node, topic = self.random.choice(ready)
            self.send(node, node.behaviour.handle(node.arrived[topic].popleft()))
            self.obey()

    def repeat(self) -> None:
        for node in self.nodes:
            if node.sent and not node.dead:
                for message in [m for m in node.sent if m.step > node.sent[-1].step - REPEATED]:
                    self.publish(message)

    def wish(self) -> None:
        request = Request(
            Action(self.random.randint(1, 6)), self.random.randint(1, 6), self.random.choice([-0.1, 0.0, 0.07, 0.2])
        )
        try:
            self.controller.ask(request)
        except InputError:
            return

    def obey(self) -> None:
        """End processes some time after their end was ordered, or never."""
        for decision in self.controller.decisions():
            self.decisions.append(decision)
            if decision.request.action in (Action.KILL, Action.FREEZE, Action.REMOVE) and self.random.random() < 0.5:
                self.robots[decision.request.agent_id].dead = decision.step is not None and self.collector.step > (
                    decision.step
                )


def steering_config(scenario: Scenario, largest_torque: float = 1.0) -> SteeringConfig:
    return SteeringConfig(
        members=configure.members(scenario),
        period_ns=scenario.step_ns,
        last_step=scenario.steps,
        schedule=configure.schedule(scenario),
        offsets=configure.step_changes(scenario, REFERENCE),
        torques=configure.step_changes(scenario, DISTURBANCE),
        largest_offset=1.0,
        largest_torque=largest_torque,
    )


PLANS = {
    "nothing": "[{kind: join, at: null, agent: 4}]",
    "much": "[{kind: join, at: null, agent: 4}, {kind: kill, at: 0.4, agent: 2}, {kind: loss, probability: 0.1},"
    " {kind: reference, at: 0.1, offset: 0.1}, {kind: disturbance, at: 0.2, torque: 0.1, until: 0.3}]",
}


@pytest.mark.parametrize("plan", PLANS)
@pytest.mark.parametrize("seed", range(8))
def test_a_steered_run_is_one_that_could_have_been_planned(plan: str, seed: int) -> None:
    """The oracle is the simulation of the scenario that the recorded events make of the one that was run."""
    name = "arise_het_4" if seed % 2 else "pd_het_4"
    limits = ("limits.force=0.3", "plane.end_stop=1.2")
    scenario = builtin(name, "duration=0.6", f"faults={PLANS[plan]}", *limits)
    swarm = Swarm(scenario, seed, packed=seed % 3 == 0)
    swarm.run(wishes=0.01)
    events = [r.message for step in swarm.steps for r in step.records if isinstance(r.message, SwarmEvent)]
    planned = as_planned(scenario, events)
    simulated = list(Simulation(planned).steps())
    assert digest(step for step in swarm.steps if step.records[0].topic is not EVENTS) == digest(simulated)
    told = [r.message for step in simulated for r in step.records if isinstance(r.message, SwarmEvent)]
    assert sorted(events) == sorted(told), "also what is announced is what would be"
    held = [decision for decision in swarm.decisions if decision.step is not None]
    assert len({decision.step for decision in held}) == len(held) > 3
    for decision in held:
        assert any(event.step == decision.step for event in events)
    assert planned != scenario


def test_without_requests_nothing_is_changed() -> None:
    scenario = builtin("pd_het_4", "duration=0.5", f"faults={PLANS['much']}")
    swarm = Swarm(scenario, 1, packed=False)
    swarm.run(wishes=0.0)
    events = [r.message for step in swarm.steps for r in step.records if isinstance(r.message, SwarmEvent)]
    assert as_planned(scenario, events) is scenario
    assert digest(swarm.steps) == digest(Simulation(scenario).steps())


# What steers


def controller(**changes: object) -> SteeringController:
    given = {"members": (1, 2, 3, 4), "period_ns": 10_000_000, "last_step": 10, "largest_offset": 1.0}
    made = SteeringController(SteeringConfig(**{**given, "largest_torque": 2.0, **changes}))  # type: ignore[arg-type]
    made.start()
    return made


def plane(step: int) -> PlaneState:
    return PlaneState(step * 10_000_000, step, 0.1, 0.0)


def test_a_request_gets_the_next_step_and_each_step_one() -> None:
    made = controller()
    assert made.handle(plane(0)) == (Steering(10_000_000, 1, 0, Action.NONE, 0, 0.0),)
    numbers = [made.ask(Request(Action.REFERENCE, 0, 0.25)), made.ask(Request(Action.KILL, 3))]
    assert made.handle(plane(0)) == (), "a repetition"
    assert made.handle(plane(1)) == (Steering(20_000_000, 2, numbers[0], Action.REFERENCE, 0, 0.25),)
    assert made.handle(plane(2)) == (Steering(30_000_000, 3, numbers[1], Action.KILL, 3, 0.0),)
    assert [(d.number, d.step) for d in made.decisions()] == [(numbers[0], 2), (numbers[1], 3)]
    assert made.decisions() == []
    assert made.members == (1, 2, 4)


def test_what_the_scenario_sets_goes_first() -> None:
    made = controller(offsets=(StepChange(1, 0.5),))
    made.ask(Request(Action.REFERENCE, 0, 0.1))
    assert [made.handle(plane(step))[0].action for step in range(2)] == [Action.NONE, Action.REFERENCE]  # type: ignore[union-attr]


def test_a_robot_that_has_just_been_added_is_there_for_a_step() -> None:
    made = controller(schedule=(Change(2**63 - 1, 4, ChangeKind.JOIN),))
    assert made.absent == (4,)
    made.ask(Request(Action.ADD, 4))
    made.handle(plane(0))
    made.ask(Request(Action.KILL, 4))
    actions = [made.handle(plane(step))[0].action for step in (1, 2)]  # type: ignore[union-attr]
    assert actions == [Action.NONE, Action.KILL]


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        (Request(Action.REFERENCE, 0, 1.01), "1.01 rad is out of range; an offset of the reference is at most 1 rad"),
        (Request(Action.DISTURBANCE, 0, float("nan")), "nan N m is out of range; a disturbance is at most 2 N m"),
        (Request(Action.DISTURBANCE, 0, float("-inf")), "-inf N m is out of range"),
        (Request(Action.KILL, 7), "there is no robot 7; there are 1, 2, 3, 4"),
        (Request(Action.KILL, 4), "robot 4 does not take part at step 1; those that do are 1, 2, 3"),
        (Request(Action.FREEZE, 3), "robot 3 does not take part at step 1; those that do are 1, 2"),
        (
            Request(Action.ADD, 1),
            "robot 1 is there by the scenario, or was added before; those that can be added are 4",
        ),
    ],
)
def test_what_is_refused(request_: Request, reason: str) -> None:
    made = controller(schedule=(Change(2**63 - 1, 4, ChangeKind.JOIN),))
    if request_.action == Action.FREEZE:
        made.handle(SwarmEvent(0, 1, 3, EventKind.DEAD, 0.0, "silent"))
    with pytest.raises(InputError) as caught:
        made.ask(request_)
    assert str(caught.value).startswith(reason)
    assert made.handle(plane(0))[0].action == Action.NONE  # type: ignore[union-attr]


def test_a_law_without_offset_is_named() -> None:
    with pytest.raises(InputError, match="offset_torque"):
        controller(largest_offset=0.0).ask(Request(Action.REFERENCE, 0, 0.1))


def test_the_last_robot_stays_and_what_waits_is_judged_again() -> None:
    made = controller(members=(1, 2))
    made.ask(Request(Action.KILL, 1))
    made.ask(Request(Action.KILL, 2))
    made.handle(plane(0))
    made.handle(plane(1))
    first, second = made.decisions()
    assert (first.step, second.step) == (1, None)
    assert "robot 2 is the last that takes part" in second.reason


def test_after_the_end_nothing_can_be_asked_for() -> None:
    made = controller(last_step=1)
    made.handle(plane(0))
    with pytest.raises(InputError, match="the run is over"):
        made.ask(Request(Action.KILL, 1))
    assert made.handle(plane(1)) == ()
    assert made.awaits() == ()


def test_too_many_requests_are_refused() -> None:
    made = controller()
    for _ in range(100):
        made.ask(Request(Action.REFERENCE, 0, 0.1))
    with pytest.raises(InputError, match="ask again later"):
        made.ask(Request(Action.REFERENCE, 0, 0.1))


# Nodes


def test_two_different_orders_of_a_step_and_orders_from_the_future() -> None:
    scenario = builtin("pd_het_4", "duration=0.3")
    node = Steered(Plane(configure.plane_config(scenario)))
    node.handle(Steering(0, 0, 0, Action.NONE, 0, 0.0))
    with pytest.raises(ConflictError):
        node.handle(Steering(0, 0, 1, Action.KILL, 1, 0.0))
    with pytest.raises(StepAheadError):
        node.handle(Steering(0, 3, 1, Action.KILL, 1, 0.0))
    assert node.missing() == (0, tuple(f"agent {i}" for i in (1, 2, 3, 4)))


def test_a_node_waits_for_the_order_and_says_so() -> None:
    node = Steered(Plane(configure.plane_config(builtin("pd_het_4", "duration=0.3"))))
    assert node.awaits() == (STEERING,)
    assert node.missing() == (0, ("steering",))
    assert not node.open
