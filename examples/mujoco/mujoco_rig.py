"""Plane and robots in MuJoCo, with motors, sensors and the faults that hardware has."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, cos, pi, sin
from random import Random
from typing import NamedTuple

import mujoco
from mujoco_world import WHEEL_RADIUS, Chassis, Friction, Physics, Plank, Robot, build, drag

WATCHDOG = 0.2
"""Time without a command after which a base stops by itself, s."""
_BRAKING_TIME = 0.1
"""Time in which the brake of a base that is driven by force stops it, s."""
_DRIVES_OFF = 0.5
"""Acceleration by which a force sets a robot in motion, more than noise makes of its brake and its weight, m/s^2."""
_HEADING_GAIN, _LANE_GAIN = 6.0, 40.0
"""Gains with which a base keeps its lane: of the heading, 1/s, and of the distance from the lane's middle, rad/m^2."""


@dataclass(frozen=True)
class Faults:
    """How sensors and motors deviate from perfect ones; 0 is perfect.

    Attributes
    ----------
    position_noise, velocity_noise : float
        Standard deviations of the odometry, m and m/s.
    tilt_noise, tilt_offset : float
        Standard deviation and offset of the plane's encoder, rad.
    delay : float
        Age of all readings and commands when they take effect, s.
    """

    position_noise: float = 0.0
    velocity_noise: float = 0.0
    tilt_noise: float = 0.0
    tilt_offset: float = 0.0
    delay: float = 0.0


class Reading(NamedTuple):
    """Measurement of a robot.

    Attributes
    ----------
    position, velocity : float
        Position, m, and velocity, m/s, along its lane.
    wheels : tuple
        Angle, rad, and angular velocity, rad/s, of its wheels, forwards; their names are `MujocoRig.joints`.
    """

    position: float
    velocity: float
    wheels: tuple[tuple[float, float], ...]


class Readings(NamedTuple):
    """Measurements of all sensors.

    Attributes
    ----------
    time : float
        Simulated time at which they were measured, s.
    encoder : float
        Angle by the encoder on the plane's axis, rad.
    tilt : tuple of float
        Angle, rad, and angular velocity, rad/s, by the robots' IMUs.
    robots : dict
        Measurements of the robots by id.
    """

    time: float
    encoder: float
    tilt: tuple[float, float]
    robots: dict[int, Reading]


class MujocoRig:
    """The world, stepped to given times.

    Parameters
    ----------
    chassis : tuple of Chassis
        Robots with wheels.
    plank, physics : Plank, Physics
        The rest of the world.
    friction : tuple of float
        g1 to g6 of the bearing.
    angle : float
        Angle at which the plank is held until a robot is commanded to drive off, rad.
    faults : Faults
        Faults of sensors and motors.
    seed : int
        Of the noise.
    disturbance : callable, optional
        Returns the torque against the plank, N m, at a time since its release, s.
    """

    def __init__(
        self,
        chassis: tuple[Chassis, ...],
        plank: Plank,
        physics: Physics,
        friction: Friction,
        angle: float,
        faults: Faults | None = None,
        seed: int = 1,
        disturbance: Callable[[float], float] | None = None,
    ) -> None:
        self.model = build(chassis, plank, physics, angle)
        self.data = mujoco.MjData(self.model)
        self.robots = {body.robot.id: body.robot for body in chassis}
        self.held = True
        self._faults = faults or Faults()
        self._friction = friction
        self._disturbance = disturbance or (lambda _: 0.0)
        self._released = 0.0
        self._random = Random(seed)  # noqa: S311 - repeatable, not secret
        self._start = angle
        self._bodies = {body.robot.id: _Body(self.model, body) for body in chassis}
        self.joints = {robot: body.joints for robot, body in self._bodies.items()}
        self._tilt = self.model.joint("tilt").qposadr[0], self.model.joint("tilt").dofadr[0]
        self._commands: deque[tuple[float, int, float]] = deque()
        self._measured: deque[Readings] = deque()
        self.data.qpos[self._tilt[0]] = angle
        mujoco.mj_forward(self.model, self.data)

    @property
    def gravity(self) -> float:
        """Acceleration of gravity, m/s^2."""
        return -float(self.model.opt.gravity[2])

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self.data.time)

    @property
    def angle(self) -> float:
        """True angle of the plank, rad."""
        return float(self.data.qpos[self._tilt[0]])

    @property
    def rate(self) -> float:
        """True angular velocity of the plank, rad/s."""
        return float(self.data.qvel[self._tilt[1]])

    def place(self, robot: int) -> float:
        """Return the true position of a robot along its lane, m."""
        return self._bodies[robot].along(self.data, self.angle, self.rate)[0]

    def drive(self, robot: int, command: float) -> None:
        """Command a base with a forward velocity (m/s) or force (N), which takes effect after the delay."""
        self._commands.append((self.time + self._faults.delay, robot, command))

    def read(self) -> Readings:
        """Let all sensors measure, and return the newest measurements that have arrived."""
        self._measured.append(self._readings())
        while len(self._measured) > 1 and self._measured[1].time <= self.time - self._faults.delay + 1e-9:
            self._measured.popleft()
        return self._measured[0]

    def _readings(self) -> Readings:
        faults, draw = self._faults, self._random.gauss
        robots = {}
        for robot, body in self._bodies.items():
            position, velocity = body.along(self.data, self.angle, self.rate)
            robots[robot] = Reading(
                position + draw(0.0, faults.position_noise),
                velocity + draw(0.0, faults.velocity_noise),
                body.wheels(self.data),
            )
        encoder = self.angle + faults.tilt_offset + draw(0.0, faults.tilt_noise)
        return Readings(self.time, encoder, (self.angle + draw(0.0, faults.tilt_noise), self.rate), robots)

    def advance(self, time: float) -> None:
        """Step the world up to a time, s."""
        while self.time < time - 0.5 * self.model.opt.timestep:
            while self._commands and self._commands[0][0] <= self.time:
                _, robot, command = self._commands.popleft()
                self._bodies[robot].commanded = self.time, command
                self.held = self.held and not self._drives_off(self.robots[robot], command)
            for body in self._bodies.values():
                body.drive(self.data, self.angle, self.rate)
            place, velocity = self._tilt
            torque = drag(self._friction, self.rate) + self._disturbance(self.time - self._released)
            self.data.qfrc_applied[velocity] = -torque
            mujoco.mj_step(self.model, self.data)
            if self.held:
                self._released = self.time
                self.data.qpos[place], self.data.qvel[velocity] = self._start, 0.0

    def _drives_off(self, robot: Robot, command: float) -> bool:
        """Return whether a command does more than to keep a robot in its place on the plank while that is held."""
        if not robot.forced:
            return command != 0.0
        holding = robot.facing * robot.mass * self.gravity * sin(self.angle)
        return abs(command - holding) > robot.mass * _DRIVES_OFF


class _Body:
    """A robot in the arrays of MuJoCo."""

    def __init__(self, model: mujoco.MjModel, chassis: Chassis) -> None:
        self._robot = robot = chassis.robot
        self._mass = chassis.mass
        joint = model.body(f"robot_{robot.id}").jntadr[0]
        self._place, self._velocity = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        self._across = float(model.body(f"robot_{robot.id}").pos[1])
        sides = {"left": -1.0, "right": 1.0}
        motors = [model.actuator(n) for n in range(model.nu)]
        mine = [motor for motor in motors if motor.name.startswith(f"motor_{robot.id}_")]
        self._motors = [(motor.id, sides[motor.name.split("_")[2]]) for motor in mine]
        axles = [model.joint(motor.name.replace("motor", "axle")) for motor in mine]
        self._axles = [(int(axle.qposadr[0]), int(axle.dofadr[0])) for axle in axles]
        self.joints = tuple(_joint(motor.name, axles=len(mine) // 2) for motor in mine)
        self._gravity = -float(model.opt.gravity[2])
        self._half_track = abs(float(model.body(f"wheel_{mine[0].name.removeprefix('motor_')}").pos[1]))
        self.commanded = -WATCHDOG, 0.0

    def along(self, data: mujoco.MjData, angle: float, rate: float) -> tuple[float, float]:
        """Return place (m) and speed (m/s) in the plank's frame, along the lane."""
        s, c = sin(angle), cos(angle)
        x, _, z = data.qpos[self._place : self._place + 3]
        vx, _, vz = data.qvel[self._velocity : self._velocity + 3]
        return float(c * x + s * z), float(c * vx + s * vz + rate * (-s * x + c * z))

    def wheels(self, data: mujoco.MjData) -> tuple[tuple[float, float], ...]:
        """Return angle (rad) and angular velocity (rad/s) of the wheels, as their encoders count."""
        return tuple((float(data.qpos[place]), float(data.qvel[speed])) for place, speed in self._axles)

    def drive(self, data: mujoco.MjData, angle: float, rate: float) -> None:
        """Set the motors for the present command, and keep to the lane."""
        robot = self._robot
        since, command = self.commanded
        position, speed = self.along(data, angle, rate)
        if data.time - since > WATCHDOG:  # the base's own brake
            weight = self._mass * (self._gravity * sin(angle) - position * rate * rate)
            command = robot.facing * (weight - self._mass * speed / _BRAKING_TIME) if robot.forced else 0.0
        turning = self._turning(data, robot.facing * speed)
        for motor, side in self._motors:
            if robot.forced:
                # Damping belongs to the robot of the paper: m v' = u - c v.
                force = command - robot.damping * robot.facing * speed
                data.ctrl[motor] = WHEEL_RADIUS * force / len(self._motors) + side * _STEERING * turning
            else:
                data.ctrl[motor] = (command + side * self._half_track * turning) / WHEEL_RADIUS

    def _turning(self, data: mujoco.MjData, forward_speed: float) -> float:
        """Return the rate of turning, rad/s, that leads back to the middle of the lane."""
        w, x, y, z = data.qpos[self._place + 3 : self._place + 7]
        heading = atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        if self._robot.facing < 0.0:
            heading -= pi if heading > 0.0 else -pi
        off = self._robot.facing * (data.qpos[self._place + 1] - self._across)
        return float(-_HEADING_GAIN * heading - _LANE_GAIN * off * forward_speed)


def _joint(motor: str, *, axles: int) -> str:
    """Return the name of the joint of a motor such as ``motor_1_left_0``, as bases of ros2_control have it."""
    *_, side, axle = motor.split("_")
    end = "" if axles == 1 else ("rear_", "front_")[int(axle)]
    return f"{end}{side}_wheel_joint"


_STEERING = 2e-3
"""Torque of a wheel per rate of turning of a base that is driven by force, N m s/rad."""
