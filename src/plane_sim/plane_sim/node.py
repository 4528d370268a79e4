"""Node ``plane_sim``: the simulated plane; on hardware an encoder's or an IMU's driver takes its place."""

from __future__ import annotations

import sys
from math import inf

from swarmabs_config.graph import PLANE
from swarmabs_core.behaviours import Plane, PlaneConfig, Steered
from swarmabs_core.faults import Lie
from swarmabs_core.friction import Friction
from swarmabs_core.parameters import Parameter
from swarmabs_core.plant import Disturbance
from swarmabs_core.sensing import Sensor
from swarmabs_core.steering import Stair
from swarmabs_ros.runner import GRAVITY, MEMBERS, SCHEDULE, STEERED, NodeSpec, Settings, run_node
from swarmabs_ros.status import StatusChannel

PARAMETERS = (
    MEMBERS,
    SCHEDULE,
    GRAVITY,
    Parameter("inertia", 0.5, "moment of inertia of the plane alone, kg m^2", above=0.0),
    Parameter("length", 1.0, "length of the plane, m", above=0.0),
    Parameter(
        "friction",
        (0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0),
        "g1 to g6 of the bearing's friction: g1, g4 in N m, g2, g3, g5 in s/rad, g6 in N m s/rad",
        minimum=0.0,
        length=6,
    ),
    Parameter("substep", 0.001, "largest integration step, s", above=0.0),
    Parameter("angle", 0.1, "initial angle, rad", minimum=-1.5, maximum=1.5),
    Parameter("angular_velocity", 0.0, "initial angular velocity, rad/s"),
    Parameter("disturbance.amplitude", 0.0, "amplitude of the disturbance torque, N m"),
    Parameter("disturbance.angular_frequency", 0.5, "angular frequency of the disturbance torque, rad/s"),
    Parameter("end_stop", 0.0, "angle of inelastic end stops on both sides, rad; 0: none", minimum=0.0),
    Parameter(
        "sensor.noise",
        (0.0, 0.0),
        "standard deviations of white noise on angle, rad, and angular velocity, rad/s",
        minimum=0.0,
        length=2,
    ),
    Parameter(
        "sensor.resolution",
        (0.0, 0.0),
        "steps to which angle, rad, and angular velocity, rad/s, are rounded; 0: none",
        minimum=0.0,
        length=2,
    ),
    Parameter("seed", 1, "seed of the sensor's noise", minimum=0),
    Parameter("actuator_lag", 0.0, "time constant of the robots' drives, s", minimum=0.0),
    Parameter("lies", (), "injected lies of robots, each 'AGENT lie FIRST END OFFSET FACTOR FACTOR'"),
    Parameter(
        "torques", (), "constant torque, N m, that disturbs the plane, each 'STEP VALUE' from a step on: '500 0.1'"
    ),
    STEERED,
)


def config(settings: Settings) -> PlaneConfig:
    """Return the behaviour's configuration."""
    return PlaneConfig(
        members=settings.integers("members"),
        period_ns=settings.integer("period_ns"),
        inertia=settings.number("inertia"),
        length=settings.number("length"),
        gravity=settings.number("gravity"),
        friction=Friction(*settings.numbers("friction")),
        substep=settings.number("substep"),
        angle=settings.number("angle"),
        angular_velocity=settings.number("angular_velocity"),
        disturbance=Disturbance(
            settings.number("disturbance.amplitude"), settings.number("disturbance.angular_frequency")
        ),
        schedule=settings.schedule(),
        last_step=settings.last_step(),
        end_stop=settings.number("end_stop") or inf,
        sensor=Sensor(settings.pair("sensor.noise"), settings.pair("sensor.resolution")),
        seed=settings.integer("seed"),
        actuator_lag=settings.number("actuator_lag"),
        lies=tuple(map(Lie.parse, settings.texts("lies"))),
        torques=tuple(map(Stair.parse, settings.texts("torques"))),
    )


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour."""
    plane = Plane(config(settings))
    return NodeSpec(Steered(plane) if settings.flag(STEERED.name) else plane)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(PLANE, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
