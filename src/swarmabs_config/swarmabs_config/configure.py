"""Derive the configurations of the nodes from a scenario."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any

from swarmabs_config import graph
from swarmabs_config.graph import Option
from swarmabs_config.model.controllers import settings_of
from swarmabs_config.model.scenario import UncheckedScenario, UncheckedSystemScenario
from swarmabs_core.behaviours import AgentConfig, ControllerConfig, LifeSpan, ObserverConfig, PlaneConfig
from swarmabs_core.behaviours.base import Run
from swarmabs_core.behaviours.systems import (
    SystemAgentConfig,
    SystemControllerConfig,
    SystemObserverConfig,
    SystemParentConfig,
)
from swarmabs_core.controllers import CONTROLLERS, ParentLaw
from swarmabs_core.declaration import gathered
from swarmabs_core.faults import (
    PARENT_FAULTS,
    Falsification,
    InjectedFault,
    MembershipFault,
    RobotFault,
    SettingFault,
)
from swarmabs_core.membership import ALWAYS, SETTLING_NS, Change, ChangeKind
from swarmabs_core.messages import Kind, RobotKind, word
from swarmabs_core.steering import DISTURBANCE, REFERENCE, OffsetReference, StepChange, StepSchedule
from swarmabs_core.swarm_law import LAWS
from swarmabs_core.systems.check import constants_of
from swarmabs_core.systems.interface import SYSTEMS

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_config.model.agents import Agent, SystemAgent
    from swarmabs_config.model.scenario import AnyScenario
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.parameters import Settings
    from swarmabs_core.registry import Registry


def plugins(scenario: AnyScenario) -> tuple[tuple[Registry[Any, Any], str], ...]:
    """Return the parts of a scenario that packages may provide, each with its registry and its name."""
    if isinstance(scenario, UncheckedSystemScenario):
        return ((SYSTEMS, scenario.system.type),)
    assert isinstance(scenario, UncheckedScenario)  # noqa: S101 - there are two kinds
    return (CONTROLLERS, scenario.controller.type), (LAWS, scenario.swarm.law.type)


def options_for(scenario: AnyScenario) -> frozenset[Option]:
    """Return the options that a scenario gives every node."""
    asked = {
        Option.SYSTEM: isinstance(scenario, UncheckedSystemScenario),
        Option.CHANGING: bool(schedule(scenario)) or division(scenario) == ALWAYS,
    }
    return frozenset(option for option, given in asked.items() if given)


def members(scenario: AnyScenario) -> tuple[int, ...]:
    """Return the ids of all robots, ascending."""
    return tuple(agent.id for agent in scenario.agents)


def schedule(scenario: AnyScenario) -> tuple[Change, ...]:
    """Return the scheduled membership changes by step."""
    return tuple(
        sorted(
            Change(scenario.fault_step(fault.at), fault.agent, ChangeKind(fault.kind))
            for fault in scenario.faults_of(MembershipFault)
        )
    )


def robot_faults(scenario: AnyScenario, agent_id: int) -> tuple[InjectedFault, ...]:
    """Return the faults injected into a robot, without changes of the membership."""
    return tuple(
        InjectedFault.of(fault, *scenario.fault_steps(fault))
        for fault in scenario.faults_of(RobotFault)
        if fault.hits(agent_id)
    )


def falsifications(scenario: AnyScenario) -> tuple[Falsification, ...]:
    """Return the faults injected into robots that the simulated parent must know, by robot."""
    return tuple(
        Falsification(agent.id, injected)
        for agent in scenario.agents
        for injected in robot_faults(scenario, agent.id)
        if isinstance(injected.fault, PARENT_FAULTS)
    )


def step_changes(scenario: AnyScenario, kind: str) -> tuple[StepChange, ...]:
    """Return the step changes of a setting (`REFERENCE` or `DISTURBANCE`); where one ends, the setting returns to 0."""
    found: dict[int, float] = {}
    for fault in scenario.faults_of(SettingFault):
        if fault.kind == kind:
            if fault.until is not None:
                found.setdefault(scenario.fault_step(fault.until), 0.0)
            found[scenario.fault_step(fault.at)] = fault.value
    return tuple(StepChange(step, found[step]) for step in sorted(found))


def recording_window(scenario: AnyScenario) -> int:
    """Return how many steps a recorded run may be ahead of the bag on disk."""
    return graph.recording_window(len(scenario.agents))


def may_change(scenario: AnyScenario, *, steered: bool) -> bool:
    """Return whether robots may join, end or be dropped, by plan or on request, so that `swarm/standing` is there."""
    return steered or Option.CHANGING in options_for(scenario)


def division(scenario: AnyScenario) -> int:
    """Return for how many steps from a change on the observer tells how the abstract state divides."""
    return ALWAYS if scenario.lockstep.on_stall == "drop" else -(-SETTLING_NS // scenario.step_ns)


def _run(scenario: AnyScenario) -> Run:
    return Run(
        period_ns=scenario.step_ns,
        last_step=scenario.steps,
        members=members(scenario),
        schedule=schedule(scenario),
        division=division(scenario),
        seed=scenario.seed,
    )


def declared(scenario: UncheckedScenario) -> tuple[object, ...]:
    """Return the declarations of a scenario from which the configurations of the nodes are gathered."""
    run = replace(_run(scenario), actuator_lag=scenario.swarm.actuator_lag)
    swarm = scenario.swarm
    of_plane = scenario.plane, scenario.manifold, parent_law(scenario), scenario.observer
    return run, *of_plane, swarm.gains, swarm.sensor, scenario.limits, scenario.realtime


def _system(scenario: UncheckedSystemScenario) -> dict[str, Any]:
    """Return the fields of a node's configuration that select the parent system."""
    return {"system": scenario.named.type, "system_settings": scenario.named.settings}


def observer_config(scenario: AnyScenario) -> ObserverConfig | SystemObserverConfig:
    """Return the observer's configuration."""
    if isinstance(scenario, UncheckedSystemScenario):
        forces = any(agent.kind == word(RobotKind.DOUBLE_INTEGRATOR) for agent in scenario.agents)
        curvature = forces and scenario.swarm.force_law == "second_order"
        return gathered(SystemObserverConfig, _run(scenario), **_system(scenario), curvature=curvature)
    assert isinstance(scenario, UncheckedScenario)  # noqa: S101 - there are two kinds
    return gathered(ObserverConfig, *declared(scenario), type=scenario.observer.type)


def parent_config(scenario: AnyScenario) -> PlaneConfig | SystemParentConfig:
    """Return the configuration of the simulated parent."""
    if isinstance(scenario, UncheckedScenario):
        return plane_config(scenario)
    assert isinstance(scenario, UncheckedSystemScenario)  # noqa: S101 - there are two kinds
    return gathered(SystemParentConfig, _run(scenario), scenario.sensor, **_system(scenario), **_changes(scenario))


def plane_config(scenario: UncheckedScenario) -> PlaneConfig:
    """Return the simulated plane's configuration."""
    return gathered(PlaneConfig, *declared(scenario), **_changes(scenario))


def _changes(scenario: AnyScenario) -> dict[str, Any]:
    """Return the fields of the parent's configuration that change its motion at planned steps."""
    return {"falsifications": falsifications(scenario), "torques": step_changes(scenario, DISTURBANCE)}


def parent_law(scenario: UncheckedScenario) -> ParentLaw:
    """Return the plane's control law by name, with its settings and the plane it controls."""
    plane = scenario.plane
    return ParentLaw(scenario.controller.type, controller_settings(scenario), plane.inertia, plane.friction)


def controller_config(scenario: AnyScenario, *, recording_window: int) -> ControllerConfig | SystemControllerConfig:
    """Return the configuration of the parent controller's node."""
    own: dict[str, Any] = {"recording_window": recording_window, "offsets": step_changes(scenario, REFERENCE)}
    if isinstance(scenario, UncheckedSystemScenario):
        swarm = scenario.swarm.gains, scenario.requests
        return gathered(SystemControllerConfig, _run(scenario), *swarm, **_system(scenario), **own)
    assert isinstance(scenario, UncheckedScenario)  # noqa: S101 - there are two kinds
    return gathered(ControllerConfig, *declared(scenario), **own)


def controller_settings(scenario: UncheckedScenario) -> Settings:
    """Return the settings of the control law, nested names joined by dots."""
    return settings_of(scenario.controller)


def parent_controller(scenario: UncheckedScenario) -> ParentController:
    """Return the plane's controller."""
    return parent_law(scenario).make(scenario.period, scenario.manifold)


def reference(scenario: AnyScenario) -> OffsetReference:
    """Return the reference angle of the plane (rad), or the references of all that another parent system tracks.

    It is a function of time (s): the reference of law or system plus the scenario's offsets.
    """
    offsets = StepSchedule(step_changes(scenario, REFERENCE))
    if isinstance(scenario, UncheckedSystemScenario):
        return OffsetReference(scenario.named.made.reference, offsets, scenario.step_ns)
    assert isinstance(scenario, UncheckedScenario)  # noqa: S101 - there are two kinds
    return OffsetReference(parent_controller(scenario).reference, offsets, scenario.step_ns)


def system_abilities(scenario: UncheckedSystemScenario) -> dict[str, bool]:
    """Return whether the reference of a parent system can be offset, and whether it can be disturbed."""
    made = scenario.named.made
    controller = made.controller(scenario.period)
    return {REFERENCE: hasattr(controller, "offset_ask"), DISTURBANCE: hasattr(made, "disturbed")}


def agent_configs(scenario: AnyScenario) -> tuple[Any, ...]:
    """Return the robots' configurations by ascending id: of `AgentConfig`, or of `SystemAgentConfig`."""
    lives: dict[int, LifeSpan] = {}
    for change in schedule(scenario):
        life = lives.get(change.agent_id, LifeSpan())
        if change.kind is ChangeKind.JOIN:
            lives[change.agent_id] = LifeSpan(change.step, life.end, life.end_step)
        else:
            lives[change.agent_id] = LifeSpan(life.first_step, change.kind, change.step)
    common, own = _common(scenario)
    return tuple(
        replace(
            common,
            **own(agent),
            life=lives.get(agent.id, LifeSpan()),
            faults=robot_faults(scenario, agent.id),
        )
        for agent in scenario.agents
    )


def _common(scenario: AnyScenario) -> tuple[Any, Callable[[Any], dict[str, Any]]]:
    """Return the configuration of robots without their own fields, and what returns these."""
    if isinstance(scenario, UncheckedScenario):
        return gathered(AgentConfig, *declared(scenario), **swarm_law(scenario)), robot
    assert isinstance(scenario, UncheckedSystemScenario)  # noqa: S101 - there are two kinds
    swarm = scenario.swarm
    effort = inf if swarm.effort is None else swarm.effort
    run = _run(scenario), swarm.gains

    def own(agent: SystemAgent) -> dict[str, Any]:
        return {
            "agent_id": agent.id,
            "kind": RobotKind[agent.kind.upper()],
            "coordinates": agent.coordinates,
            "velocities": agent.velocities,
            "constants": constants_of(scenario.named, agent.constants),
        }

    return gathered(SystemAgentConfig, *run, **_system(scenario), force_law=swarm.force_law, effort=effort), own


def swarm_law(scenario: UncheckedScenario) -> dict[str, Any]:
    """Return the fields of a robot's configuration that select its control law."""
    return {"law": scenario.swarm.law.type, "law_settings": settings_of(scenario.swarm.law)}


def robot(agent: Agent) -> dict[str, Any]:
    """Return the fields of a robot's configuration that describe the robot itself."""
    return {
        "agent_id": agent.id,
        "kind": Kind[agent.kind.upper()],
        "mass": agent.mass,
        "damping": agent.damping,
        "position": agent.position,
        "velocity": agent.velocity,
    }
