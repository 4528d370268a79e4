"""A world of MuJoCo: a plank on a hinge, and robots that drive on it in lanes.

The frame of the plank has x along the lanes, y across them and z upwards, with the axis at the origin. The angle of the
hinge is positive where the side of positive x is up, as in swarmabs.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin, tanh
from typing import Any, Literal

import mujoco
import numpy as np

Base = Literal["slider", "differential", "rover"]

WHEEL_RADIUS, WHEEL_WIDTH, WHEEL_MASS = 0.02, 0.012, 0.01
"""Radius and width, m, and mass, kg, of a wheel."""
AXLES, TRACK = 0.035, 0.036
"""Half of the distances of a rover's axles and of the wheels of an axle, m."""
AXLE, BALL = 0.015, -0.04
"""Places of the axle and of the ball of a differential drive, m; with three points of contact each bears its share."""
CHASSIS = (0.1, 0.06, 0.03)
"""Size of a chassis, m."""
LANE, THICKNESS, OVERHANG = 0.12, 0.01, 0.1
"""Width of a lane, thickness of the plank, and its length beyond the lanes' ends, m."""
_BEARING = 1e-5
"""Damping (N m s/rad) and reflected inertia (kg m^2) of a wheel's motor."""


_WOOD, _MARK = [0.78, 0.65, 0.47, 1.0], [0.45, 0.36, 0.25, 1.0]
"""Colours of the plank, and of the lines between its lanes."""

Friction = tuple[float, float, float, float, float, float]
"""g1 to g6 of the bearing."""


@dataclass(frozen=True)
class Robot:
    """What the swarm, and the robot's own electronics, know of a robot.

    Attributes
    ----------
    id : int
        Its number in the swarm.
    forced : bool
        Whether its command is a force (double integrator), not a velocity.
    mass, damping : float
        Mass, kg, and viscous damping of its motion, N s/m.
    position : float
        Where it is put down on its lane, m.
    facing : float
        1 along the lane, -1 against it.
    """

    id: int
    forced: bool
    mass: float
    damping: float
    position: float
    facing: float = 1.0


@dataclass(frozen=True)
class Chassis:
    """What of a robot only the world knows.

    Attributes
    ----------
    robot : Robot
        What its own electronics and the swarm know.
    mass : float
        True mass with wheels, kg.
    height : float
        Height of its centre of mass above the surface, m.
    base : str
        How it moves: a rover has four driven wheels, a differential drive two in front of a ball. A slider has no
        wheels: it moves as prescribed.
    """

    robot: Robot
    mass: float
    height: float = 0.03
    base: Base = "rover"


@dataclass(frozen=True)
class Plank:
    """The plank: moment of inertia about the axis (kg m^2), length (m), mass (kg) and height of its centre (m)."""

    inertia: float = 0.5
    length: float = 1.0
    mass: float = 1.0
    center_height: float = 0.0
    end_stop: float = 0.5  # rad


@dataclass(frozen=True)
class Physics:
    """What the engine needs besides robots and plank."""

    gravity: float = 9.81  # m/s^2
    timestep: float = 0.001  # s
    grip: float = 1.0  # coefficient of sliding friction of the wheels
    stiffness: float = 0.006  # of the velocity loop of a wheel, N m s/rad
    torque: float = 0.05  # largest of a wheel, N m


def build(robots: tuple[Chassis, ...], plank: Plank, physics: Physics, angle: float) -> mujoco.MjModel:
    """Return the model of a world whose plank is at an angle (rad), with all robots at rest on it."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    option = spec.option
    option.timestep, option.gravity = physics.timestep, [0.0, 0.0, -physics.gravity]
    sliding = any(chassis.base == "slider" for chassis in robots)
    integrator = mujoco.mjtIntegrator
    option.integrator = integrator.mjINT_RK4 if sliding else integrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    _scenery(spec, len(robots))
    body = _plank(spec, plank, physics, len(robots))
    for number, chassis in enumerate(robots):
        across = (number - (len(robots) - 1) / 2.0) * LANE
        if chassis.base == "slider":
            _slider(body, chassis, across)
        else:
            _wheeled(spec, chassis, across, physics, angle)
    return spec.compile()


def wheels_of(base: Base) -> int:
    """Return the number of wheels of a base."""
    return {"slider": 0, "differential": 2, "rover": 4}[base]


def drag(friction: Friction, rate: float) -> float:
    """Return the friction torque of the bearing, N m, at an angular velocity, rad/s."""
    g1, g2, g3, g4, g5, g6 = friction
    return g1 * (tanh(g2 * rate) - tanh(g3 * rate)) + g4 * tanh(g5 * rate) + g6 * rate


def _scenery(spec: Any, lanes: int) -> None:
    """Add what only a picture needs: sky, light, and the support of the axis."""
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.97],
        rgb2=[0.75, 0.8, 0.86],
        width=64,
        height=384,
    )
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.visual.headlight.diffuse = [0.35, 0.35, 0.35]
    spec.worldbody.add_light(
        pos=[-0.5, -0.8, 2.0],
        dir=[0.25, 0.4, -1.0],
        diffuse=[0.5, 0.5, 0.5],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        castshadow=True,
    )
    seen = {"contype": 0, "conaffinity": 0, "rgba": [0.35, 0.37, 0.4, 1.0]}
    half = lanes * LANE / 2.0 + 0.03
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        fromto=[0.0, -half, -0.017, 0.0, half, -0.017],
        size=[0.006, 0.0, 0.0],
        **seen,
    )
    for side in (-half, half):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.008, 0.17], pos=[0.0, side, -0.17], **seen
        )
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[4.0, 4.0, 0.1],
        pos=[0.0, 0.0, -0.34],
        contype=0,
        conaffinity=0,
        rgba=[0.85, 0.86, 0.88, 1.0],
    )


def _plank(spec: Any, plank: Plank, physics: Physics, lanes: int) -> Any:
    body = spec.worldbody.add_body(name="plane", explicitinertial=True)
    body.mass, body.ipos = plank.mass, [0.0, 0.0, plank.center_height]
    # MuJoCo wants the inertia about the centre of mass; the scenario has that about the axis.
    about_centre = plank.inertia - plank.mass * plank.center_height**2
    body.inertia = [about_centre] * 3
    body.add_joint(
        name="tilt",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0.0, -1.0, 0.0],
        limited=True,
        range=[-plank.end_stop, plank.end_stop],
    )
    body.add_geom(
        name="surface",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[plank.length / 2.0 + OVERHANG, lanes * LANE / 2.0, THICKNESS / 2.0],
        pos=[0.0, 0.0, -THICKNESS / 2.0],
        friction=[physics.grip, 0.005, 0.0001],
        rgba=_WOOD,
        contype=1,
        conaffinity=2,
    )
    for edge in range(1, lanes):
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[plank.length / 2.0, 0.001, 0.0002],
            pos=[0.0, (edge - lanes / 2.0) * LANE, 0.0],
            rgba=_MARK,
            contype=0,
            conaffinity=0,
        )
    return body


def _slider(plank: Any, chassis: Chassis, across: float) -> None:
    number = chassis.robot.id
    body = plank.add_body(name=f"robot_{number}", pos=[0.0, across, chassis.height], explicitinertial=True)
    # Without a place of its own, a centre of mass has that of the body once more.
    body.mass, body.inertia, body.ipos = chassis.mass, [1e-12] * 3, [0.0, 0.0, 0.0]
    body.add_joint(name=f"slide_{number}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0])


def _wheeled(spec: Any, chassis: Chassis, across: float, physics: Physics, angle: float) -> None:
    robot = chassis.robot
    yaw = 0.0 if robot.facing > 0.0 else pi
    tilted = np.array([cos(angle / 2.0), 0.0, -sin(angle / 2.0), 0.0])
    turned = np.zeros(4)
    mujoco.mju_mulQuat(turned, tilted, np.array([cos(yaw / 2.0), 0.0, 0.0, sin(yaw / 2.0)]))
    place = np.zeros(3)
    mujoco.mju_rotVecQuat(place, np.array([robot.position, across, WHEEL_RADIUS]), tilted)
    body = spec.worldbody.add_body(name=f"robot_{robot.id}", pos=place, quat=turned, explicitinertial=True)
    body.add_freejoint()
    ends = (-AXLES, AXLES) if chassis.base == "rover" else (AXLE,)
    a, b, c = CHASSIS
    body.mass = chassis.mass - wheels_of(chassis.base) * WHEEL_MASS
    above = (chassis.height - WHEEL_RADIUS) * chassis.mass / body.mass  # chassis above the axles
    body.ipos = [0.0, 0.0, above]
    body.inertia = [body.mass / 12.0 * (x * x + y * y) for x, y in ((b, c), (a, c), (a, b))]
    box = mujoco.mjtGeom.mjGEOM_BOX
    rgba = [0.85, 0.45, 0.2, 1.0] if robot.forced else [0.2, 0.5, 0.8, 1.0]
    body.add_geom(type=box, size=[a / 2, b / 2, c / 2], pos=[0.0, 0.0, c / 2], rgba=rgba, contype=0, conaffinity=0)
    contact = {"contype": 2, "conaffinity": 1}
    if chassis.base == "differential":
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[WHEEL_RADIUS / 2.0, 0.0, 0.0],
            pos=[BALL, 0.0, -WHEEL_RADIUS / 2.0],
            friction=[0.01, 0.005, 0.0001],
            priority=1,
            **contact,
        )
    for side in (-1, 1):
        for number, end in enumerate(ends):
            name = f"{robot.id}_{'left' if side > 0 else 'right'}_{number}"
            wheel = body.add_body(name=f"wheel_{name}", pos=[end, side * TRACK, 0.0])
            wheel.add_joint(
                name=f"axle_{name}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=[0.0, 1.0, 0.0],
                damping=_BEARING,
                armature=_BEARING,
            )
            wheel.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[WHEEL_RADIUS, WHEEL_WIDTH / 2.0, 0.0],
                quat=[cos(pi / 4.0), sin(pi / 4.0), 0.0, 0.0],
                mass=WHEEL_MASS,
                friction=[physics.grip, 0.005, 0.0001],
                rgba=[0.1, 0.1, 0.1, 1.0],
                **contact,
            )
            motor = spec.add_actuator(name=f"motor_{name}", target=f"axle_{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT)
            if robot.forced:
                motor.set_to_motor()
            else:
                motor.set_to_velocity(kv=physics.stiffness)
            motor.forcelimited, motor.forcerange = True, [-physics.torque, physics.torque]
