"""Node ``agent_node`` in real time: one robot behind its drive."""

from __future__ import annotations

import sys
from math import inf
from typing import TYPE_CHECKING

from agent_node.drives import DRIVE, make_drive, with_drive
from agent_node.node import PARAMETERS as LOCKSTEP, gains_of, kind_of, with_law
from swarmabs_config.graph import ROBOT, SERVICES
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.agent import RealtimeAgent, RealtimeAgentConfig
from swarmabs_core.realtime.base import AGENT_PHASE
from swarmabs_core.realtime.plausibility import Bounds
from swarmabs_core.robot_controller import Limits
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import choose, run_realtime, schedule_of

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings

SWARM_MASS = Parameter(
    "swarm_mass",
    0.0,
    "mass of all robots that ever take part, kg, which bounds what a broadcast may say; 0: unknown",
    minimum=0.0,
)
PARAMETERS = (
    *choose(LOCKSTEP, "agent_id", "kind", "mass", "damping", "position", "velocity", "gravity", "plane_length"),
    *choose(LOCKSTEP, "gains.k", "gains.kp", "gains.kd", "gains.ksd", "limits.velocity", "limits.force", "law.type"),
    SWARM_MASS,
    Parameter(
        "limits.deceleration",
        0.0,
        "how hard the base of a single integrator brakes, m/s^2; 0: it stops at once",
        minimum=0.0,
    ),
    Parameter(
        "lane_margin",
        0.02,
        "distance from the plane's ends at which the robot must have come to rest, m",
        minimum=0.0,
    ),
    Parameter(
        "broadcast_age_limit",
        0.1,
        "age of the newest complete broadcasts from which on the robot stops, s",
        above=0.0,
    ),
    Parameter(
        "measurement_age_limit",
        0.1,
        "age of the measurement of its own motion from which on the robot stops, s",
        above=0.0,
    ),
    DRIVE,
)


def table(node: RealtimeNode) -> tuple[Parameter, ...]:
    """Return the node's parameters, among them those of the law and of the drive that are asked for."""
    return with_drive(node, with_law(node, PARAMETERS))


def config(settings: Settings) -> RealtimeAgentConfig:
    """Return the behaviour's configuration.

    Raises
    ------
    InputError
        If parameters contradict each other.
    """
    length = settings.number("plane_length")
    law = settings.within("law.")
    clock = schedule_of(settings)
    mass = settings.number(SWARM_MASS.name) or inf
    return RealtimeAgentConfig(
        agent_id=settings.integer("agent_id"),
        kind=kind_of(settings),
        mass=settings.number("mass"),
        gains=gains_of(settings),
        schedule=clock,
        bounds=Bounds(settings.number("gravity"), length, mass, clock.period_ns / 1e9),
        lane_limit=max(0.0, 0.5 * length - settings.number("lane_margin")),
        damping=settings.number("damping"),
        limits=Limits(settings.number("limits.velocity") or inf, settings.number("limits.force") or inf),
        deceleration=settings.number("limits.deceleration") or inf,
        broadcast_age_limit=settings.number("broadcast_age_limit"),
        measurement_age_limit=settings.number("measurement_age_limit"),
        clock_tolerance=settings.number("clock_tolerance"),
        law=str(law.pop("type")),
        law_settings=law,
    )


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    """Return the behaviour, the drive open."""
    robot = config(settings)
    agent = RealtimeAgent(robot, make_drive(settings, robot, node))
    return RealtimeSpec(
        agent,
        AGENT_PHASE,
        services=dict(zip(SERVICES[ROBOT], (agent.leave, agent.join), strict=True)),
    )


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_realtime(ROBOT, table, make, args)


if __name__ == "__main__":
    sys.exit(main())
