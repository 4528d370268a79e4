"""From a scenario to the configurations of the realtime nodes."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_core.behaviours.agent import RobotConfig
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Mode
from swarmabs_core.realtime.agent import RealtimeAgentConfig
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.controller import RealtimeControllerConfig
from swarmabs_core.realtime.observer import RealtimeObserverConfig
from swarmabs_core.realtime.plane import RealtimePlaneConfig
from swarmabs_core.realtime.validation import Bounds

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario


def check_realtime(scenario: Scenario) -> None:
    """Refuse what a scenario may ask for in lockstep only.

    Raises
    ------
    InputError
        Naming the field and what to do.
    """
    lockstep_only = (
        ("plane.robot_gravity", scenario.plane.robot_gravity),
        ("swarm.actuator_lag", scenario.swarm.actuator_lag > 0.0),
        ("swarm.sensor", not scenario.swarm.sensor.perfect),
        ("observer.type", scenario.observer.type != "sum"),
        ("faults", bool(scenario.faults)),
    )
    for name, given in lockstep_only:
        if given:
            raise InputError(f"{name}: there is none in real time with simulated robots; remove it, or run in lockstep")


def schedule(scenario: Scenario, epoch_ns: int) -> Schedule:
    """Return how time becomes steps, from an epoch in ns since 1970."""
    return Schedule(scenario.step_ns, epoch_ns)


def bounds(scenario: Scenario) -> Bounds:
    """Return what is known of the swarm and its plane beforehand."""
    return Bounds(scenario.plane.gravity, scenario.plane.length, swarm_mass(scenario), scenario.period)


def swarm_mass(scenario: Scenario) -> float:
    """Return the mass of all robots, kg."""
    return sum(agent.mass for agent in scenario.agents)


def agent_configs(scenario: Scenario, clock: Schedule) -> tuple[RealtimeAgentConfig, ...]:
    """Return the robots' configurations by ascending id."""
    limits = scenario.realtime
    shared = {field.name for field in fields(RobotConfig)}
    return tuple(
        RealtimeAgentConfig(
            **{name: getattr(config, name) for name in shared},
            schedule=clock,
            swarm_mass=swarm_mass(scenario),
            lane_margin=limits.lane_margin,
            broadcast_age_limit=limits.broadcast_age_limit,
            clock_tolerance=limits.clock_tolerance,
        )
        for config in configure.agent_configs(scenario)
    )


def observer_config(scenario: Scenario, clock: Schedule) -> RealtimeObserverConfig:
    """Return the observer's configuration."""
    members, limits = configure.members(scenario), scenario.realtime
    return RealtimeObserverConfig(
        members=members,
        schedule=clock,
        gravity=scenario.plane.gravity,
        ksd=scenario.swarm.gains.ksd,
        plane_length=scenario.plane.length,
        swarm_mass=swarm_mass(scenario),
        state_age_limit=limits.state_age_limit,
        start=limits.start,
        quorum=None if limits.quorum is None else min(limits.quorum, len(members)),
        clock_tolerance=limits.clock_tolerance,
    )


def plane_config(scenario: Scenario, clock: Schedule) -> RealtimePlaneConfig:
    """Return the simulated plane's configuration."""
    return RealtimePlaneConfig(
        members=configure.members(scenario),
        schedule=clock,
        plane=scenario.plane,
        seed=scenario.seed,
        clock_tolerance=scenario.realtime.clock_tolerance,
    )


def controller_config(scenario: Scenario, clock: Schedule, start_mode: Mode = Mode.RUN) -> RealtimeControllerConfig:
    """Return the configuration of the parent controller's node."""
    return RealtimeControllerConfig(
        schedule=clock,
        manifold=scenario.manifold,
        law=configure.parent_law(scenario),
        gravity=scenario.plane.gravity,
        plane_length=scenario.plane.length,
        start_mode=start_mode,
        plane_age_limit=scenario.realtime.plane_age_limit,
        clock_tolerance=scenario.realtime.clock_tolerance,
    )
