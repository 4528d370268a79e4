"""Derive the configurations of the nodes from a scenario."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING, Any, overload

from swarmabs_config import graph
from swarmabs_config.graph import Option
from swarmabs_config.model.controllers import settings_of
from swarmabs_config.model.fields import LARGEST
from swarmabs_config.model.scenario import PlaneScenario
from swarmabs_core.behaviours import Peer
from swarmabs_core.controllers import CONTROLLERS, OffsetController, ParentLaw
from swarmabs_core.declaration import gathered
from swarmabs_core.faults import (
    PARENT_FAULTS,
    Falsification,
    InjectedFault,
    MembershipFault,
    RobotFault,
    SettingFault,
)
from swarmabs_core.heights import CenterHeights
from swarmabs_core.links import Links
from swarmabs_core.membership import ALWAYS, SETTLING_NS, Change, ChangeKind
from swarmabs_core.messages import Kind
from swarmabs_core.models import (
    AgentConfig,
    ControllerConfig,
    ObserverConfig,
    PlaneConfig,
    SystemAgentConfig,
    SystemControllerConfig,
    SystemObserverConfig,
    SystemParentConfig,
)
from swarmabs_core.settings import LifeSpan, Run
from swarmabs_core.steering import DISTURBANCE, REFERENCE, OffsetReference, StepChange, StepSchedule
from swarmabs_core.summation import exact_sum
from swarmabs_core.swarm_law import LAWS
from swarmabs_core.systems.check import constants_of
from swarmabs_core.systems.interface import SYSTEMS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Container, Iterator
    from typing import TypeAlias

    from swarmabs_config.model.agents import Agent
    from swarmabs_config.model.scenario import Scenario, SystemScenario
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.messages import Vector
    from swarmabs_core.parameters import Settings
    from swarmabs_core.registry import Registry

    Plugins: TypeAlias = tuple[tuple[Registry[Any, Any], str], ...]


LARGEST_OFFSET = 1.0
"""Largest offset of the plane's reference that can be requested, rad; a run ends at `plant.STEEPEST`."""


def plugins(scenario: Scenario) -> Plugins:
    """Return the parts of a scenario that packages may provide, each with its registry and its name."""
    return _nodes(scenario).plugins


def options_for(scenario: Scenario) -> frozenset[Option]:
    """Return the options that a scenario gives every node."""
    asked = {
        Option.SYSTEM: scenario.named is not None,
        Option.CHANGING: bool(schedule(scenario)) or division(scenario) == ALWAYS,
    }
    return frozenset(option for option, given in asked.items() if given)


def members(scenario: Scenario) -> tuple[int, ...]:
    """Return the ids of all robots, ascending."""
    return tuple(agent.id for agent in scenario.agents)


def schedule(scenario: Scenario) -> tuple[Change, ...]:
    """Return the scheduled membership changes by step."""
    return tuple(
        sorted(
            Change(scenario.fault_step(fault.at), fault.agent, ChangeKind(fault.kind))
            for fault in scenario.faults_of(MembershipFault)
        )
    )


def robot_faults(scenario: Scenario, agent_id: int) -> tuple[InjectedFault, ...]:
    """Return the faults injected into a robot, without changes of the membership."""
    return tuple(
        InjectedFault.of(fault, *scenario.fault_steps(fault))
        for fault in scenario.faults_of(RobotFault)
        if fault.hits(agent_id)
    )


def falsifications(scenario: Scenario) -> tuple[Falsification, ...]:
    """Return the faults injected into robots that the simulated parent must know, by robot."""
    return tuple(
        Falsification(agent.id, injected)
        for agent in scenario.agents
        for injected in robot_faults(scenario, agent.id)
        if isinstance(injected.fault, PARENT_FAULTS)
    )


def step_changes(scenario: Scenario, kind: str) -> tuple[StepChange, ...]:
    """Return the step changes of a setting (`REFERENCE` or `DISTURBANCE`); where one ends, the setting returns to 0."""
    values: dict[int, float] = {}
    for fault in scenario.faults_of(SettingFault):
        if fault.kind == kind:
            if fault.until is not None:
                values.setdefault(scenario.fault_step(fault.until), 0.0)
            values[scenario.fault_step(fault.at)] = fault.value
    return tuple(StepChange(step, values[step]) for step in sorted(values))


def recording_window(scenario: Scenario) -> int:
    """Return how many steps a recorded run may be ahead of the bag on disk."""
    return graph.recording_window(len(scenario.agents), relayed=scenario.decentralised)


def may_change(scenario: Scenario, *, steered: bool) -> bool:
    """Return whether robots may join, end or be dropped, by plan or on request, so that `swarm/standing` is there."""
    return steered or Option.CHANGING in options_for(scenario)


def division(scenario: Scenario) -> int:
    """Return for how many steps from a change on the observer tells how the abstract state divides."""
    return ALWAYS if scenario.lockstep.on_stall == "drop" else -(-SETTLING_NS // scenario.step_ns)


def _run(scenario: Scenario) -> Run:
    return Run(
        period_ns=scenario.step_ns,
        last_step=scenario.steps,
        members=members(scenario),
        schedule=schedule(scenario),
        division=division(scenario),
        seed=scenario.seed,
    )


class _PlaneNodes:
    """Configurations of the nodes on the plane, from the declarations of a scenario."""

    def __init__(self, scenario: PlaneScenario) -> None:
        self._scenario = scenario

    @property
    def plugins(self) -> Plugins:
        scenario = self._scenario
        return (CONTROLLERS, scenario.controller.type), (LAWS, scenario.swarm.law.type)

    @property
    def reference(self) -> Callable[[float], float]:
        return parent_controller(self._scenario).reference

    @property
    def largest_requests(self) -> dict[str, float]:
        offset = isinstance(parent_controller(self._scenario), OffsetController)
        return {REFERENCE: LARGEST_OFFSET * offset, DISTURBANCE: self._scenario.manifold.torque_max}

    def observer(self) -> ObserverConfig:
        return gathered(ObserverConfig, *declared(self._scenario), type=self._scenario.observer.type)

    def parent(self, **own: object) -> PlaneConfig:
        return gathered(PlaneConfig, *declared(self._scenario), **own)

    def controller(self, **own: object) -> ControllerConfig:
        return gathered(ControllerConfig, *declared(self._scenario), **own)

    def agents(self) -> Iterator[AgentConfig]:
        common = gathered(AgentConfig, *declared(self._scenario), **swarm_law(self._scenario))
        return (replace(common, **robot(agent)) for agent in self._scenario.agents)


class _SystemNodes:
    """Configurations of the nodes on another parent system, from the declarations of a scenario."""

    def __init__(self, scenario: SystemScenario) -> None:
        self._scenario = scenario
        self._named = scenario.named
        self._selected: dict[str, object] = {"system": self._named.type, "system_settings": self._named.settings}

    @property
    def plugins(self) -> Plugins:
        return ((SYSTEMS, self._scenario.system.type),)

    @property
    def reference(self) -> Callable[[float], Vector]:
        return self._named.instance.reference

    @property
    def largest_requests(self) -> dict[str, float]:
        instance = self._named.instance
        controller = instance.controller(self._scenario.period)
        able = {REFERENCE: hasattr(controller, "offset_ask"), DISTURBANCE: hasattr(instance, "disturbed")}
        return {kind: LARGEST * given for kind, given in able.items()}

    def observer(self) -> SystemObserverConfig:
        scenario = self._scenario
        forces = any(Kind.of(agent.kind).by_force for agent in scenario.agents)
        curvature = forces and scenario.swarm.force_law == "second_order"
        return gathered(SystemObserverConfig, _run(scenario), **self._selected, curvature=curvature)

    def parent(self, **own: object) -> SystemParentConfig:
        scenario = self._scenario
        return gathered(SystemParentConfig, _run(scenario), scenario.sensor, **self._selected, **own)

    def controller(self, **own: object) -> SystemControllerConfig:
        scenario = self._scenario
        swarm = scenario.swarm.gains, scenario.requests
        return gathered(SystemControllerConfig, _run(scenario), *swarm, **self._selected, **own)

    def agents(self) -> Iterator[SystemAgentConfig]:
        scenario = self._scenario
        swarm, named = scenario.swarm, self._named
        common = gathered(
            SystemAgentConfig,
            _run(scenario),
            swarm.gains,
            **self._selected,
            force_law=swarm.force_law,
            effort=inf if swarm.effort is None else swarm.effort,
        )
        return (
            replace(
                common,
                agent_id=agent.id,
                kind=Kind.of(agent.kind),
                coordinates=agent.coordinates,
                velocities=agent.velocities,
                constants=constants_of(named, agent.constants),
            )
            for agent in scenario.agents
        )


def _nodes(scenario: Scenario) -> _PlaneNodes | _SystemNodes:
    """Return what configures the nodes of a scenario, by its parent system."""
    return _PlaneNodes(scenario) if isinstance(scenario, PlaneScenario) else _SystemNodes(scenario)


def declared(scenario: PlaneScenario) -> tuple[object, ...]:
    """Return the declarations of a scenario from which the configurations of the nodes are gathered."""
    run = replace(_run(scenario), actuator_lag=scenario.swarm.actuator_lag)
    swarm = scenario.swarm
    of_plane = scenario.plane, scenario.manifold, parent_law(scenario), scenario.observer, center_heights(scenario)
    return run, *of_plane, swarm.gains, swarm.sensor, scenario.limits, scenario.realtime


def center_heights(scenario: PlaneScenario) -> CenterHeights:
    """Return the heights of the robots' centres of mass, none if all are 0."""
    heights = tuple(agent.center_height for agent in scenario.agents)
    return CenterHeights(heights if any(heights) else ())


def observer_config(scenario: Scenario) -> ObserverConfig | SystemObserverConfig:
    """Return the observer's configuration."""
    return _nodes(scenario).observer()


@overload
def parent_config(scenario: PlaneScenario) -> PlaneConfig: ...
@overload
def parent_config(scenario: Scenario) -> PlaneConfig | SystemParentConfig: ...
def parent_config(scenario: Scenario) -> PlaneConfig | SystemParentConfig:
    """Return the configuration of the simulated parent."""
    return _nodes(scenario).parent(falsifications=falsifications(scenario), torques=step_changes(scenario, DISTURBANCE))


def parent_law(scenario: PlaneScenario) -> ParentLaw:
    """Return the plane's control law by name, with its settings and the plane it controls."""
    plane, controller = scenario.plane, scenario.controller
    moment = exact_sum([plane.moment, *(agent.mass * agent.center_height for agent in scenario.agents)])
    return ParentLaw(
        controller.type,
        controller_settings(scenario),
        plane.inertia,
        plane.friction,
        controller.height_compensation,
        moment,
    )


@overload
def controller_config(scenario: PlaneScenario, *, recording_window: int) -> ControllerConfig: ...
@overload
def controller_config(scenario: Scenario, *, recording_window: int) -> ControllerConfig | SystemControllerConfig: ...
def controller_config(scenario: Scenario, *, recording_window: int) -> ControllerConfig | SystemControllerConfig:
    """Return the configuration of the parent controller's node."""
    offsets = step_changes(scenario, REFERENCE)
    return _nodes(scenario).controller(recording_window=recording_window, offsets=offsets)


def controller_settings(scenario: PlaneScenario) -> Settings:
    """Return the settings of the control law, nested names joined by dots."""
    return settings_of(scenario.controller)


def parent_controller(scenario: PlaneScenario) -> ParentController:
    """Return the plane's controller."""
    return parent_law(scenario).make(scenario.period, scenario.manifold)


def law_reference(scenario: Scenario) -> Callable[[float], float] | Callable[[float], Vector]:
    """Return the reference of the plane's law (rad), or those of another parent system, as a function of time (s)."""
    return _nodes(scenario).reference


def reference(scenario: Scenario) -> OffsetReference:
    """Return the reference angle of the plane (rad), or the references of all that another parent system tracks.

    It is a function of time (s): the reference of law or system plus the scenario's offsets.
    """
    offsets = StepSchedule(step_changes(scenario, REFERENCE))
    return OffsetReference(law_reference(scenario), offsets, scenario.step_ns)


def largest_requests(scenario: Scenario) -> dict[str, float]:
    """Return the largest offset of the reference and the largest disturbance that can be requested; 0: none."""
    return _nodes(scenario).largest_requests


@overload
def agent_configs(scenario: PlaneScenario) -> tuple[AgentConfig, ...]: ...
@overload
def agent_configs(scenario: SystemScenario) -> tuple[SystemAgentConfig, ...]: ...
@overload
def agent_configs(scenario: Scenario) -> tuple[AgentConfig | SystemAgentConfig, ...]: ...
def agent_configs(scenario: Scenario) -> tuple[AgentConfig | SystemAgentConfig, ...]:
    """Return the robots' configurations by ascending id."""
    lives: dict[int, LifeSpan] = {}
    for change in schedule(scenario):
        life = lives.get(change.agent_id, LifeSpan())
        if change.kind is ChangeKind.JOIN:
            lives[change.agent_id] = LifeSpan(change.step, life.end, life.end_step)
        else:
            lives[change.agent_id] = LifeSpan(life.first_step, change.kind, change.step)
    return tuple(
        replace(
            config,
            life=lives.get(config.agent_id, LifeSpan()),
            faults=robot_faults(scenario, config.agent_id),
        )
        for config in _nodes(scenario).agents()
    )


def links(scenario: Scenario) -> Links:
    """Return which robots hear each other, where each of them coordinates the swarm; raise `InputError` if some do not.

    Robots that join later pass on messages from the start.
    """
    return _links(scenario.links, members(scenario))


_links = lru_cache(maxsize=4)(Links)  # drawing those of a large swarm takes long, and each of its processes needs them


def peers(
    scenario: Scenario, robots: Container[int], *, recorded: bool = True, steered: bool = False
) -> tuple[Peer, ...]:
    """Return the robots with these ids, each with an observer and a parent controller of its own.

    The run may be `recorded`, and never ahead of its bag by more than a window, and `steered`.
    """
    observer = observer_config(scenario)
    controller = controller_config(scenario, recording_window=recording_window(scenario) if recorded else 0)
    between = links(scenario)
    return tuple(
        Peer(observer, controller, config, between, steered=steered)
        for config in agent_configs(scenario)
        if config.agent_id in robots
    )


def peer_endpoints(scenario: Scenario, robots: Collection[int], *, steered: bool) -> graph.Endpoints:
    """Return the endpoints of a process with these robots, each of which coordinates the swarm by itself."""
    between = links(scenario)
    also = {Option.SENSING: any(map(between.senses, robots)), Option.STEERED: steered, Option.CHANGING: steered}
    return graph.endpoints(
        graph.PEER,
        graph.LOCKSTEP,
        options_for(scenario) | {option for option, given in also.items() if given},
        members=robots,
        neighbours=sorted({near for robot in robots for near in between.of(robot)}),
    )


def relaying(scenario: Scenario) -> tuple[int, ...]:
    """Return the ids of the robots that pass on what they know to others, ascending."""
    return members(scenario) if scenario.decentralised else ()


def swarm_law(scenario: PlaneScenario) -> dict[str, object]:
    """Return the fields of a robot's configuration that select its control law."""
    return {"law": scenario.swarm.law.type, "law_settings": settings_of(scenario.swarm.law)}


def robot(agent: Agent) -> dict[str, Any]:
    """Return the fields of a robot's configuration that describe the robot itself."""
    return {
        "agent_id": agent.id,
        "kind": Kind.of(agent.kind),
        "mass": agent.mass,
        "damping": agent.damping,
        "position": agent.position,
        "velocity": agent.velocity,
    }
