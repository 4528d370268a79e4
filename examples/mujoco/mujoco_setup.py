"""A rig for a scenario, with the deviations from it that hardware has."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isinf
from random import Random
from typing import TYPE_CHECKING, get_args

from mujoco_rig import Faults, MujocoRig
from mujoco_world import WHEEL_MASS, Base, Chassis, Physics, Plank, Robot, wheels_of

from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from swarmabs_config.scenario import PlaneScenario

BASES = tuple(base for base in get_args(Base) if base != "slider")
"""Bases with wheels."""
HEIGHT = Chassis.height
"""Height of a robot's centre of mass if the scenario has none, m."""
END_STOP = Plank.end_stop
"""Angle of the end stops if the scenario has none, rad."""
FAULTS = Faults(position_noise=0.001, velocity_noise=0.01, tilt_noise=0.001, delay=0.02)
"""Sensors and motors, unless others are given."""
GRIPPING = Physics(grip=0.6)
"""Wheels and engine, unless others are given."""


@dataclass(frozen=True)
class Setup:
    """A rig, as it differs from the scenario.

    Attributes
    ----------
    base : str
        Base of all robots.
    height : float, optional
        Height of the robots' centres of mass, m; None: `center_height` of the scenario, or `HEIGHT` where that is 0.
    mass_error : float
        Largest relative error of the masses that the robots know.
    tilt_offset : float
        Largest offset of the plane's encoder beside that of `faults`, rad.
    faults, physics : Faults, Physics
        Sensors and motors; wheels and engine.
    """

    base: Base = "rover"
    height: float | None = None
    mass_error: float = 0.15
    tilt_offset: float = 0.005
    faults: Faults = FAULTS
    physics: Physics = GRIPPING


def facing_of(robot: int) -> float:
    """Return 1 for a robot that faces along its lane, -1 for every third one, which faces against it."""
    return -1.0 if robot % 3 == 0 else 1.0


def rig_of(scenario: PlaneScenario, setup: Setup, seed: int) -> MujocoRig:
    """Return the rig of a scenario; masses and the offset of the encoder are drawn by the seed.

    Raises
    ------
    InputError
        If no such rig can be built; the text names the field and the remedy.
    """
    end_stop = end_stop_of(scenario, setup)
    draw = Random(seed).uniform  # noqa: S311 - repeatable, not secret
    bodies = []
    for agent in scenario.agents:
        forced = agent.kind == "double_integrator"
        robot = Robot(agent.id, forced, agent.mass, agent.damping, agent.position, facing_of(agent.id))
        true_mass = agent.mass * (1.0 + draw(-setup.mass_error, setup.mass_error))
        height = (agent.center_height or HEIGHT) if setup.height is None else setup.height
        bodies.append(Chassis(robot, true_mass, height, setup.base))
    plane = scenario.plane
    offset = setup.faults.tilt_offset + draw(-setup.tilt_offset, setup.tilt_offset)
    faults = replace(setup.faults, tilt_offset=offset)
    return MujocoRig(
        tuple(bodies),
        Plank(
            plane.inertia, plane.length, plane.mass or Plank.mass, plane.center_height if plane.mass else 0.0, end_stop
        ),
        replace(setup.physics, gravity=plane.gravity),
        plane.friction,
        plane.angle,
        faults,
        seed,
        plane.disturbance.torque,
    )


def end_stop_of(scenario: PlaneScenario, setup: Setup) -> float:
    """Return the angle of the rig's end stops, rad; raises `InputError` as `rig_of` does."""
    plane = scenario.plane
    end_stop = END_STOP if isinf(plane.end_stop) else plane.end_stop
    if abs(plane.angle) > end_stop:
        raise InputError(
            f"plane.angle: {plane.angle:g} rad is beyond the rig's end stops at {end_stop:g} rad; set plane.end_stop"
        )
    if plane.angular_velocity:
        raise InputError("plane.angular_velocity: the rig begins at rest; set it to 0")
    wheels = wheels_of(setup.base) * WHEEL_MASS
    for agent in scenario.agents:
        if agent.mass * (1.0 - setup.mass_error) <= wheels:
            raise InputError(
                f"swarm.agents, robot {agent.id}: the wheels of a {setup.base} weigh {wheels:g} kg, so a mass of "
                f"{agent.mass:g} kg is too small; give a larger one"
            )
    return end_stop
