"""From a scenario to the configurations of the realtime nodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_core.behaviours import AgentConfig, Limits
from swarmabs_core.desired_state import STEEPEST
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Mode
from swarmabs_core.realtime.agent import RealtimeAgentConfig
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.controller import RealtimeControllerConfig
from swarmabs_core.realtime.observer import FEWEST, RealtimeObserverConfig
from swarmabs_core.realtime.plane import RealtimePlaneConfig
from swarmabs_core.realtime.plausibility import Bounds

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
        ("swarm.sensor", not configure.robot_sensor(scenario).perfect),
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
    mass = sum(agent.mass for agent in scenario.agents)
    return Bounds(scenario.plane.gravity, scenario.plane.length, mass, scenario.period)


def lane_limit(scenario: Scenario) -> float:
    """Return how far from the axis a robot may come, m."""
    return max(0.0, 0.5 * scenario.plane.length - scenario.realtime.lane_margin)


def needed(scenario: Scenario) -> int:
    """Return how many robots must have been heard before the swarm moves."""
    if scenario.realtime.start == "quorum":
        return min(scenario.realtime.quorum or FEWEST, len(scenario.agents))
    return len(scenario.agents) if scenario.realtime.start == "wait" else FEWEST


def agent_configs(scenario: Scenario, clock: Schedule) -> tuple[RealtimeAgentConfig, ...]:
    """Return the robots' configurations by ascending id."""
    return tuple(_agent(scenario, config, clock) for config in configure.agent_configs(scenario))


def _agent(scenario: Scenario, config: AgentConfig, clock: Schedule) -> RealtimeAgentConfig:
    return RealtimeAgentConfig(
        agent_id=config.agent_id,
        kind=config.kind,
        mass=config.mass,
        gains=config.gains,
        schedule=clock,
        bounds=bounds(scenario),
        lane_limit=lane_limit(scenario),
        damping=config.damping,
        limits=Limits(config.limits.velocity, config.limits.force),
        broadcast_age_limit=scenario.realtime.broadcast_age_limit,
        clock_tolerance=scenario.realtime.clock_tolerance,
        law=config.law,
        law_settings=config.law_settings,
    )


def observer_config(scenario: Scenario, clock: Schedule) -> RealtimeObserverConfig:
    """Return the observer's configuration."""
    return RealtimeObserverConfig(
        members=configure.members(scenario),
        schedule=clock,
        bounds=bounds(scenario),
        ksd=scenario.swarm.gains.ksd,
        needed=needed(scenario),
        state_age_limit=scenario.realtime.state_age_limit,
        clock_tolerance=scenario.realtime.clock_tolerance,
    )


def plane_config(scenario: Scenario, clock: Schedule) -> RealtimePlaneConfig:
    """Return the simulated plane's configuration."""
    plane = configure.plane_config(scenario)
    return RealtimePlaneConfig(
        members=plane.members,
        schedule=clock,
        bounds=bounds(scenario),
        inertia=plane.inertia,
        friction=plane.friction,
        substep=plane.substep,
        angle=plane.angle,
        angular_velocity=plane.angular_velocity,
        disturbance=plane.disturbance,
        end_stop=min(plane.end_stop, STEEPEST),
        sensor=plane.sensor,
        seed=plane.seed,
        clock_tolerance=scenario.realtime.clock_tolerance,
    )


def controller_config(scenario: Scenario, clock: Schedule, start_mode: Mode = Mode.RUN) -> RealtimeControllerConfig:
    """Return the configuration of the parent controller's node."""
    return RealtimeControllerConfig(
        schedule=clock,
        bounds=bounds(scenario),
        manifold=configure.manifold(scenario),
        start_mode=start_mode,
        plane_age_limit=scenario.realtime.plane_age_limit,
        clock_tolerance=scenario.realtime.clock_tolerance,
    )
