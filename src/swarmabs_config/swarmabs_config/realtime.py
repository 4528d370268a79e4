"""Derive the configurations of the real-time nodes from a scenario."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from swarmabs_config import configure, graph
from swarmabs_config.scenario import on_plane
from swarmabs_core.declaration import gathered
from swarmabs_core.errors import InputError
from swarmabs_core.messages import PARENT, PLANE_STATE, Mode, relay_topic
from swarmabs_core.realtime.agent import RealtimeAgentConfig
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.controller import RealtimeControllerConfig
from swarmabs_core.realtime.leadership import TAKEOVER_STEPS, Pair
from swarmabs_core.realtime.observer import RealtimeObserverConfig
from swarmabs_core.realtime.plane import RealtimePlaneConfig
from swarmabs_core.realtime.validation import Bounds
from swarmabs_core.summation import exact_sum

if TYPE_CHECKING:
    from swarmabs_config.scenario import PlaneScenario, Scenario
    from swarmabs_core.realtime.peer import RealtimePeerConfig


def check_realtime(scenario: Scenario) -> PlaneScenario:
    """Return a scenario that can run in real time.

    Raises
    ------
    InputError
        If its parent system is not the plane, or it has a setting that only lockstep supports; the text names the field
        and the remedy.
    """
    supported = on_plane(scenario, "real time")
    lockstep_only = (
        ("plane.robot_gravity", supported.plane.robot_gravity),
        ("swarm.actuator_lag", supported.swarm.actuator_lag > 0.0),
        ("swarm.sensor", not supported.swarm.sensor.perfect),
        ("observer.type", supported.observer.type != "sum"),
        ("faults", bool(supported.faults)),
    )
    for name, given in lockstep_only:
        if given:
            raise InputError(
                f"{name}: not supported in real time with simulated robots", "remove it, or run in lockstep"
            )
    return supported


def check_pairs(scenario: PlaneScenario) -> None:
    """Reject a scenario in which a standby coordinator would take over too late to keep the robots moving.

    Raises
    ------
    InputError
        If it would; the text names the field and the remedy.
    """
    limits = scenario.realtime
    latest = limits.broadcast_age_limit - TAKEOVER_STEPS * scenario.period
    if limits.takeover_after >= latest:
        raise InputError(
            f"realtime.takeover_after: {limits.takeover_after:g} s is too long for a fleet with standbys: a takeover "
            f"takes {TAKEOVER_STEPS} periods more, and robots stop after realtime.broadcast_age_limit "
            f"({limits.broadcast_age_limit:g} s)",
            f"set it below {latest:g} s, or raise the age limit",
        )


def schedule(scenario: Scenario, epoch_ns: int) -> Schedule:
    """Return the conversion of time to steps, from an epoch in ns since 1970."""
    return Schedule(scenario.step_ns, epoch_ns)


def bounds(scenario: PlaneScenario) -> Bounds:
    """Return the known bounds of the swarm and its plane."""
    mass = exact_sum(agent.mass for agent in scenario.agents)
    return Bounds(scenario.plane.gravity, scenario.plane.length, mass, scenario.period)


def agent_configs(scenario: PlaneScenario, clock: Schedule) -> tuple[RealtimeAgentConfig, ...]:
    """Return the robots' configurations by ascending id."""
    common = gathered(RealtimeAgentConfig, *_declared(scenario, clock), **configure.swarm_law(scenario))
    return tuple(replace(common, **configure.robot(agent)) for agent in scenario.agents)


def observer_config(scenario: PlaneScenario, clock: Schedule) -> RealtimeObserverConfig:
    """Return the observer's configuration."""
    quorum, robots = scenario.realtime.quorum, len(scenario.agents)
    return gathered(
        RealtimeObserverConfig,
        *_declared(scenario, clock),
        quorum=None if quorum is None else min(quorum, robots),
    )


def plane_config(scenario: PlaneScenario, clock: Schedule) -> RealtimePlaneConfig:
    """Return the simulated plane's configuration."""
    return gathered(RealtimePlaneConfig, *_declared(scenario, clock))


def controller_config(
    scenario: PlaneScenario, clock: Schedule, start_mode: Mode = Mode.RUN
) -> RealtimeControllerConfig:
    """Return the configuration of the parent controller's node."""
    return gathered(RealtimeControllerConfig, *_declared(scenario, clock), start_mode=start_mode)


def peer_config(scenario: PlaneScenario, clock: Schedule, agent_id: int) -> RealtimePeerConfig:
    """Return what a robot that coordinates the swarm by itself needs to know beyond what it hosts."""
    from swarmabs_core.realtime.peer import RealtimePeerConfig  # noqa: PLC0415 - loading NumPy would delay every run

    links = configure.links(scenario)
    return gathered(
        RealtimePeerConfig,
        *_declared(scenario, clock),
        scenario.links,
        agent_id=agent_id,
        neighbours=links.of(agent_id),
        senses=links.senses(agent_id),
    )


def peer_endpoints(config: RealtimePeerConfig, options: frozenset[graph.Option] = frozenset()) -> graph.Endpoints:
    """Return the endpoints of a robot that coordinates the swarm by itself."""
    also = {graph.Option.SENSING} if config.senses else set()
    ends = graph.endpoints(
        graph.PEER, graph.REALTIME, options | also, members=(config.agent_id,), neighbours=config.neighbours
    )
    # What has arrived from robots is read before the plane's state, which lets the robot sum up.
    reads = sorted(ends.subscriptions.items(), key=lambda read: read[0] in {PLANE_STATE, relay_topic(PARENT)})
    return replace(ends, subscriptions=dict(reads))


def _declared(scenario: PlaneScenario, clock: Schedule) -> tuple[object, ...]:
    pair = Pair(takeover_after=scenario.realtime.takeover_after)
    return *configure.declared(scenario), clock, bounds(scenario), pair
