"""Derive the configurations of the nodes from a scenario."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

from swarmabs_config import graph
from swarmabs_core.behaviours import AgentConfig, ControllerConfig, LifeSpan, ObserverConfig, PlaneConfig
from swarmabs_core.behaviours.base import Run
from swarmabs_core.controllers import ParentLaw
from swarmabs_core.declaration import gathered
from swarmabs_core.faults import (
    Falsification,
    FalsifiedStateFault,
    InjectedFault,
    MembershipFault,
    RobotFault,
    SettingFault,
)
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import Kind
from swarmabs_core.steering import DISTURBANCE, REFERENCE, OffsetReference, StepChange, StepSchedule

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic import BaseModel

    from swarmabs_config.model.agents import Agent
    from swarmabs_config.model.scenario import UncheckedScenario
    from swarmabs_core.controllers import ParentController
    from swarmabs_core.parameters import Settings, Value


def members(scenario: UncheckedScenario) -> tuple[int, ...]:
    """Return the ids of all robots, ascending."""
    return tuple(agent.id for agent in scenario.agents)


def schedule(scenario: UncheckedScenario) -> tuple[Change, ...]:
    """Return the scheduled membership changes by step."""
    return tuple(
        sorted(
            Change(scenario.fault_step(fault.at), fault.agent, ChangeKind(fault.kind))
            for fault in scenario.faults_of(MembershipFault)
        )
    )


def robot_faults(scenario: UncheckedScenario, agent_id: int) -> tuple[InjectedFault, ...]:
    """Return the faults injected into a robot, without changes of the membership."""
    return tuple(
        InjectedFault.of(fault, *scenario.fault_steps(fault))
        for fault in scenario.faults_of(RobotFault)
        if fault.hits(agent_id)
    )


def falsifications(scenario: UncheckedScenario) -> tuple[Falsification, ...]:
    """Return the falsified states injected into all robots, by robot."""
    return tuple(
        Falsification(agent.id, injected)
        for agent in scenario.agents
        for injected in robot_faults(scenario, agent.id)
        if isinstance(injected.fault, FalsifiedStateFault)
    )


def step_changes(scenario: UncheckedScenario, kind: str) -> tuple[StepChange, ...]:
    """Return the step changes of a setting (`REFERENCE` or `DISTURBANCE`); where one ends, the setting returns to 0."""
    found: dict[int, float] = {}
    for fault in scenario.faults_of(SettingFault):
        if fault.kind == kind:
            if fault.until is not None:
                found.setdefault(scenario.fault_step(fault.until), 0.0)
            found[scenario.fault_step(fault.at)] = fault.value
    return tuple(StepChange(step, found[step]) for step in sorted(found))


def recording_window(scenario: UncheckedScenario) -> int:
    """Return how many steps a recorded run may be ahead of the bag on disk."""
    return graph.recording_window(len(scenario.agents))


def declared(scenario: UncheckedScenario) -> tuple[object, ...]:
    """Return the declarations of a scenario from which the configurations of the nodes are gathered."""
    run = Run(
        period_ns=scenario.step_ns,
        last_step=scenario.steps,
        members=members(scenario),
        schedule=schedule(scenario),
        seed=scenario.seed,
        actuator_lag=scenario.swarm.actuator_lag,
    )
    swarm = scenario.swarm
    of_plane = scenario.plane, scenario.manifold, parent_law(scenario), scenario.observer
    return run, *of_plane, swarm.gains, swarm.sensor, scenario.limits, scenario.realtime


def observer_config(scenario: UncheckedScenario) -> ObserverConfig:
    """Return the observer's configuration."""
    return gathered(ObserverConfig, *declared(scenario), type=scenario.observer.type)


def plane_config(scenario: UncheckedScenario) -> PlaneConfig:
    """Return the simulated plane's configuration."""
    return gathered(
        PlaneConfig,
        *declared(scenario),
        falsifications=falsifications(scenario),
        torques=step_changes(scenario, DISTURBANCE),
    )


def parent_law(scenario: UncheckedScenario) -> ParentLaw:
    """Return the plane's control law by name, with its settings and the plane it controls."""
    plane = scenario.plane
    return ParentLaw(scenario.controller.type, controller_settings(scenario), plane.inertia, plane.friction)


def controller_config(scenario: UncheckedScenario, *, recording_window: int) -> ControllerConfig:
    """Return the configuration of the parent controller's node."""
    offsets = step_changes(scenario, REFERENCE)
    return gathered(ControllerConfig, *declared(scenario), recording_window=recording_window, offsets=offsets)


def controller_settings(scenario: UncheckedScenario) -> Settings:
    """Return the settings of the control law, nested names joined by dots."""
    return _settings(scenario.controller)


def _settings(part: BaseModel) -> Settings:
    found: dict[str, Value] = {}

    def flatten(prefix: str, values: Mapping[str, object]) -> None:
        for key, value in values.items():
            if isinstance(value, dict):
                flatten(f"{prefix}{key}.", value)
            else:
                found[prefix + key] = cast("Value", value)

    flatten("", part.model_dump(exclude={"type"}, by_alias=True))
    return found


def parent_controller(scenario: UncheckedScenario) -> ParentController:
    """Return the plane's controller."""
    return parent_law(scenario).make(scenario.period, scenario.manifold)


def reference(scenario: UncheckedScenario) -> OffsetReference:
    """Return the desired angle (rad) over time (s): the law's reference plus the scenario's offsets."""
    offsets = StepSchedule(step_changes(scenario, REFERENCE))
    return OffsetReference(parent_controller(scenario).reference, offsets, scenario.step_ns)


def agent_configs(scenario: UncheckedScenario) -> tuple[AgentConfig, ...]:
    """Return the robots' configurations by ascending id."""
    lives: dict[int, LifeSpan] = {}
    for change in schedule(scenario):
        life = lives.get(change.agent_id, LifeSpan())
        if change.kind is ChangeKind.JOIN:
            lives[change.agent_id] = LifeSpan(change.step, life.end, life.end_step)
        else:
            lives[change.agent_id] = LifeSpan(life.first_step, change.kind, change.step)
    common = gathered(AgentConfig, *declared(scenario), **swarm_law(scenario))
    return tuple(
        replace(
            common,
            **robot(agent),
            life=lives.get(agent.id, LifeSpan()),
            faults=robot_faults(scenario, agent.id),
        )
        for agent in scenario.agents
    )


def swarm_law(scenario: UncheckedScenario) -> dict[str, Any]:
    """Return the fields of a robot's configuration that select its control law."""
    return {"law": scenario.swarm.law.type, "law_settings": _settings(scenario.swarm.law)}


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
