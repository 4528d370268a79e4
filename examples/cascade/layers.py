"""A cascade of two layers in one process: each plane with its swarm is a layer with its own namespace."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from functools import cache
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from coupling import Coupled, Following, TiltDrive, carried, led

from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_config import configure
from swarmabs_config.scenario import load_scenario, on_plane
from swarmabs_core.behaviours import Agent, Controller, Observer, Parent
from swarmabs_core.controllers import ParentContext
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import AGENT_STATE, BROADCASTS, EVENTS, PLANE_STATE, TOPIC_OF, Topic
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from swarmabs_bag.run.step import Step
    from swarmabs_config.scenario import PlaneScenario
    from swarmabs_core.behaviours import Behaviour
    from swarmabs_core.messages import Message

FOLDER = Path(__file__).parent
UPPER = "/upper"


def lower(robot: int) -> str:
    """Return the namespace of the plane that drives an upper robot."""
    return f"/lower_{robot}"


@dataclass(frozen=True, slots=True)
class Coupling:
    """How the layers are coupled.

    Parameters
    ----------
    ratio : float
        Speed of an upper robot by tilt of its lower plane, m/(s rad).
    bandwidth : float
        Bandwidth of the filter for the reference of a lower plane, rad/s.

    Raises
    ------
    InputError
        If one is not a positive number.
    """

    ratio: float = 1.0
    bandwidth: float = 15.0

    def __post_init__(self) -> None:
        for name, value in (("ratio", self.ratio), ("bandwidth", self.bandwidth)):
            if not 0.0 < value < inf:
                raise InputError(f"coupling: {name} is {value}; give a positive number")


@dataclass(frozen=True, slots=True)
class CascadeScenario:
    """The upper scenario, the lower ones by the robot they drive, and their coupling.

    Raises
    ------
    InputError
        If the layers are inconsistent.
    """

    upper: PlaneScenario
    lower: Mapping[int, PlaneScenario]
    coupling: Coupling

    def __post_init__(self) -> None:
        robots = [agent.id for agent in self.upper.agents]
        if sorted(self.lower) != robots:
            raise InputError(f"the upper robots are {robots}, but lower planes are given for {sorted(self.lower)}")
        for robot, scenario in self.lower.items():
            if (scenario.step_ns, scenario.steps) != (self.upper.step_ns, self.upper.steps):
                raise InputError(f"{lower(robot)}: step and duration differ from those of {UPPER}; make them equal")
        for agent in self.upper.agents:
            if agent.kind != "single_integrator":
                raise InputError(f"{UPPER}: robot {agent.id} must be a single_integrator: a tilt sets its speed")

    @property
    def layers(self) -> dict[str, PlaneScenario]:
        """The scenarios by namespace, the upper one first."""
        return {UPPER: self.upper, **{lower(robot): scenario for robot, scenario in self.lower.items()}}


def load_cascade(
    folder: Path = FOLDER, coupling: Coupling | None = None, overrides: Sequence[str] = ()
) -> CascadeScenario:
    """Load ``upper.yaml`` and a ``lower_ID.yaml`` for each of its robots.

    Parameters
    ----------
    folder : Path
        Where the files are.
    coupling : Coupling, optional
        How the layers are coupled.
    overrides : sequence of str
        ``a.b=value`` each, for every layer.

    Raises
    ------
    InputError
        If a file is missing or invalid, or the layers are inconsistent.
    """
    upper = layer(folder / "upper.yaml", overrides)
    lower_planes = {agent.id: layer(folder / f"lower_{agent.id}.yaml", overrides) for agent in upper.agents}
    return CascadeScenario(upper, lower_planes, coupling or Coupling())


def layer(file: Path, overrides: Sequence[str] = ()) -> PlaneScenario:
    """Load the scenario of one layer."""
    return on_plane(load_scenario(file, overrides), "a cascade")


@cache
def absolute(topic: Topic, namespace: str) -> Topic:
    """Return a topic of a layer with its absolute name, cached because topics are compared by identity."""
    return Topic(f"{namespace}/{topic.name}", topic.message, topic.ros_type)


def carried_robot(upper: PlaneScenario, robot: int, plane: PlaneScenario, coupling: Coupling) -> Coupled:
    """Return an upper robot whose drive is the plane of a lower scenario."""
    (config,) = (config for config in configure.agent_configs(upper) if config.agent_id == robot)
    angle, rate = plane.plane.angle, plane.plane.angular_velocity
    drive = TiltDrive(coupling.ratio, upper.period, angle, rate)
    moving = replace(config, velocity=coupling.ratio * angle)
    agent = Agent(moving, moving.body(drive))
    return carried(agent, drive, absolute(PLANE_STATE, lower(robot)), upper.steps)


def led_controller(scenario: PlaneScenario, robot: int, coupling: Coupling, *, recording_window: int) -> Coupled:
    """Return the controller of a lower plane, which follows the command of the robot driven by the plane."""
    plane = scenario.plane
    law = Following(
        configure.parent_controller(scenario),
        ParentContext(scenario.period, plane.inertia, plane.friction, scenario.manifold),
        coupling.ratio,
        coupling.bandwidth,
        plane.angle,
        plane.angular_velocity,
    )
    config = configure.controller_config(scenario, recording_window=recording_window)
    controller = Controller(config, config.desired_states(law))
    return led(controller, law, absolute(AGENT_STATE, UPPER), robot, scenario.steps)


class CascadeSimulation:
    """All layers of a cascade, connected by a queue.

    Parameters
    ----------
    cascade : CascadeScenario
        The cascade to simulate.
    """

    def __init__(self, cascade: CascadeScenario) -> None:
        self._behaviours: list[tuple[str, Behaviour]] = []
        self._hear: dict[tuple[str, Topic], list[tuple[str, Behaviour]]] = {}
        self._collectors = {
            namespace: RunCollector(configure.members(scenario), configure.schedule(scenario), scenario.steps, memory=2)
            for namespace, scenario in cascade.layers.items()
        }
        upper = cascade.upper
        coupling = cascade.coupling
        robots = {robot: carried_robot(upper, robot, plane, coupling) for robot, plane in cascade.lower.items()}
        controller = Controller(configure.controller_config(upper, recording_window=0))
        self._add(UPPER, upper, controller, list(robots.values()))
        for robot, scenario in cascade.lower.items():
            follower = led_controller(scenario, robot, coupling, recording_window=0)
            self._add(lower(robot), scenario, follower, list(map(Agent, configure.agent_configs(scenario))))
            self._hear[lower(robot), PLANE_STATE].append((UPPER, robots[robot]))
            self._hear[UPPER, AGENT_STATE].append((lower(robot), follower))

    def _add(self, namespace: str, scenario: PlaneScenario, controller: Behaviour, agents: Sequence[Behaviour]) -> None:
        """Add the behaviours of a layer and their subscriptions within it."""
        observer = Observer(configure.observer_config(scenario))
        plane = Parent(configure.parent_config(scenario))
        hearers: dict[Topic, Sequence[Behaviour]] = {
            AGENT_STATE: (observer, plane),
            PLANE_STATE: (controller,),
            EVENTS: (plane,),
            **dict.fromkeys(BROADCASTS, agents),
        }
        for topic, those in hearers.items():
            self._hear[namespace, topic] = [(namespace, behaviour) for behaviour in those]
        behaviours: tuple[Behaviour, ...] = (observer, plane, controller, *agents)
        self._behaviours.extend((namespace, behaviour) for behaviour in behaviours)

    def steps(self) -> Iterator[tuple[str, Step]]:
        """Run the simulation, and yield every step of every layer with its namespace.

        Raises
        ------
        RunError
            If the run fails, for example because a plane turns over, or stalls.
        """
        queue: deque[tuple[str, Message]] = deque()
        for namespace, behaviour in self._behaviours:
            queue.extend((namespace, message) for message in behaviour.start())
        while queue:
            namespace, message = queue.popleft()
            for step in self._collectors[namespace].add(Record.of(message)):
                yield namespace, step
            for layer, behaviour in self._hear[namespace, TOPIC_OF[type(message)]]:
                queue.extend((layer, answer) for answer in behaviour.handle(message))
        for namespace, collector in self._collectors.items():
            if not collector.finished:
                missing = ", ".join(collector.missing())
                raise RunError(f"{namespace} stalls at step {collector.step}; missing: {missing}")
