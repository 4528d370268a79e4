"""Node ``plane_sim`` in real time, for demonstrations and tests: a plane that is simulated by the clock."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from plane_sim.node import PARAMETERS as LOCKSTEP
from swarmabs_config.graph import PLANE
from swarmabs_core.desired_state import STEEPEST
from swarmabs_core.friction import Friction
from swarmabs_core.plant import Disturbance
from swarmabs_core.realtime.base import PLANE_PHASE
from swarmabs_core.realtime.plane import RealtimePlane, RealtimePlaneConfig
from swarmabs_core.realtime.plausibility import Bounds
from swarmabs_core.sensing import Sensor
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import choose, run_realtime, schedule_of

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings

PARAMETERS = (
    *choose(LOCKSTEP, "members", "gravity", "inertia", "length", "friction", "substep", "angle", "angular_velocity"),
    *choose(LOCKSTEP, "disturbance.amplitude", "disturbance.angular_frequency", "end_stop"),
    *choose(LOCKSTEP, "sensor.noise", "sensor.resolution", "seed"),
)


def config(settings: Settings) -> RealtimePlaneConfig:
    """Return the behaviour's configuration."""
    clock = schedule_of(settings)
    return RealtimePlaneConfig(
        members=settings.integers("members"),
        schedule=clock,
        bounds=Bounds(settings.number("gravity"), settings.number("length"), period=clock.period_ns / 1e9),
        inertia=settings.number("inertia"),
        friction=Friction(*settings.numbers("friction")),
        substep=settings.number("substep"),
        angle=settings.number("angle"),
        angular_velocity=settings.number("angular_velocity"),
        disturbance=Disturbance(
            settings.number("disturbance.amplitude"), settings.number("disturbance.angular_frequency")
        ),
        end_stop=settings.number("end_stop") or STEEPEST,
        sensor=Sensor(settings.pair("sensor.noise"), settings.pair("sensor.resolution")),
        seed=settings.integer("seed"),
        clock_tolerance=settings.number("clock_tolerance"),
    )


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:  # noqa: ARG001 - it needs no more of its node
    """Return the behaviour."""
    return RealtimeSpec(RealtimePlane(config(settings)), PLANE_PHASE)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_realtime(PLANE, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
