"""The physics of the rig: a plane on a bearing, four robots on it, their motors and their sensors.

Nothing here is shared with swarmabs: the equations are formulated and integrated independently, including effects that
the control laws neglect. Gravity pulls a double integrator along the tilted plane, the rotation pushes it outwards,
motors lag behind their commands, and sensors are noisy and coarse.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, cos, exp, pi, sin, tanh
from random import Random
from typing import Literal

GRAVITY = 9.81
INERTIA = 0.5  # kg m^2, of the plane alone
LENGTH = 1.0  # m
START = 0.1  # rad, initial angle, held until the robots move
END_STOP = 0.5  # rad
SUBSTEP = 0.001  # s
LAG = 0.03  # s, of all motors
WATCHDOG = 0.2  # s without a command after which a base stops by itself
BRAKING_TIME = 0.1  # s
POSITION_NOISE, VELOCITY_NOISE = 0.0005, 0.005  # m, m/s
TILT_NOISE, RATE_NOISE = 0.001, 0.002  # rad, rad/s
PLANE_COUNTS = 65536  # of the plane's encoder, per turn
WHEEL_COUNTS = 4096  # of a wheel's encoder, per turn


@dataclass(frozen=True, slots=True)
class Robot:
    """A robot: `facing` is 1 along the lane and -1 against it; `source` is its position sensor."""

    id: int
    kind: Literal["single_integrator", "double_integrator"]
    mass: float
    damping: float
    position: float
    facing: float
    source: Literal["odometry from its start", "localisation", "wheel"]
    wheel_radius: float = 0.03


ROBOTS = (
    Robot(1, "single_integrator", 0.3552, 0.0, 0.125, 1.0, "odometry from its start"),
    Robot(2, "single_integrator", 0.3532, 0.0, -0.125, -1.0, "odometry from its start"),
    Robot(3, "double_integrator", 0.6762, 0.6524, 0.125, 1.0, "localisation"),
    Robot(4, "double_integrator", 0.4596, 1.3258, -0.125, -1.0, "wheel"),
)


def friction(rate: float) -> float:
    """Return the friction torque of the bearing, N m, at an angular velocity, rad/s."""
    return 0.01 * (tanh(1000.0 * rate) - tanh(700.0 * rate)) + 0.02 * tanh(1000.0 * rate) + rate


class Body:
    """A robot on the plane: its motion along the lane, and its motor with a lag."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.position, self.velocity = robot.position, 0.0
        self.motor = 0.0  # actual output of the motor along the lane, m/s or N
        self.command = 0.0  # commanded output
        self.commanded_at: float | None = None

    @property
    def forced(self) -> bool:
        """Whether it is driven by force."""
        return self.robot.kind == "double_integrator"


class Rig:
    """Plane and robots, integrated by the classical Runge-Kutta method.

    Parameters
    ----------
    robots : tuple of Robot
        The robots on it.
    seed : int
        Seed of the sensors' noise.
    """

    def __init__(self, robots: tuple[Robot, ...] = ROBOTS, seed: int = 1) -> None:
        self.bodies = {robot.id: Body(robot) for robot in robots}
        self.angle, self.rate = START, 0.0
        self.time = 0.0
        self.held = True
        self.noise = Random(seed)  # noqa: S311 - repeatable, not secret

    def drive(self, robot: int, command: float) -> None:
        """Command a base with a forward velocity (m/s) or force (N); the first motion releases the plane."""
        body = self.bodies[robot]
        body.command, body.commanded_at = body.robot.facing * command, self.time
        if command and not body.forced:
            self.held = False

    def advance(self, time: float) -> None:
        """Integrate up to a time, s."""
        while self.time + SUBSTEP <= time:
            self._motors()
            self._substep()
            self.time += SUBSTEP

    def _motors(self) -> None:
        for body in self.bodies.values():
            output = body.command
            if body.commanded_at is None or self.time - body.commanded_at > WATCHDOG:
                # The base's own brake, which also holds the weight.
                output = -body.robot.mass * body.velocity / BRAKING_TIME - self._weight(body) if body.forced else 0.0
            body.motor += (1.0 - exp(-SUBSTEP / LAG)) * (output - body.motor)

    def _weight(self, body: Body) -> float:
        """Return the force along the lane by which the tilted, turning plane moves a robot."""
        return body.robot.mass * (body.position * self.rate**2 - GRAVITY * sin(self.angle))

    def _substep(self) -> None:
        bodies = list(self.bodies.values())
        for body in bodies:
            if not body.forced:
                body.velocity = body.motor
        before = [self.angle, self.rate, *(b.position for b in bodies), *(b.velocity for b in bodies)]

        def moved(slope: list[float], time: float) -> list[float]:
            return [x + time * s for x, s in zip(before, slope, strict=True)]

        k1 = self._slope(before, bodies)
        k2 = self._slope(moved(k1, SUBSTEP / 2), bodies)
        k3 = self._slope(moved(k2, SUBSTEP / 2), bodies)
        k4 = self._slope(moved(k3, SUBSTEP), bodies)
        mean = [(a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]
        self.angle, self.rate, *rest = moved(mean, SUBSTEP)
        for number, body in enumerate(bodies):
            body.position, body.velocity = rest[number], rest[len(bodies) + number]
            if abs(body.position) > LENGTH / 2:  # a bumper
                body.position, body.velocity = copysign(LENGTH / 2, body.position), 0.0
        if self.held:
            self.angle, self.rate = START, 0.0
        elif abs(self.angle) > END_STOP:
            self.angle, self.rate = copysign(END_STOP, self.angle), 0.0

    def _slope(self, state: list[float], bodies: list[Body]) -> list[float]:
        angle, rate, *rest = state
        positions, velocities = rest[: len(bodies)], rest[len(bodies) :]
        torque = inertia = inertia_rate = 0.0
        accelerations = []
        for body, p, v in zip(bodies, positions, velocities, strict=True):
            m = body.robot.mass
            torque += GRAVITY * m * p
            inertia += m * p * p
            inertia_rate += 2.0 * m * p * v
            pull = m * (p * rate * rate - GRAVITY * sin(angle))
            force = body.motor - body.robot.damping * v + pull
            accelerations.append(force / m if body.forced else 0.0)
        turning = (-cos(angle) * torque - inertia_rate * rate - friction(rate)) / (INERTIA + inertia)
        return [rate, turning, *velocities, *accelerations]

    def position(self, robot: int) -> tuple[float, float]:
        """Return position, m, and velocity, m/s, along the lane as measured by an odometry."""
        body = self.bodies[robot]
        return body.position + self.noise.gauss(0.0, POSITION_NOISE), body.velocity + self.noise.gauss(
            0.0, VELOCITY_NOISE
        )

    def wheel(self, robot: int) -> float:
        """Return the forward rotation of a wheel since the robot was put down, rad, as measured by its encoder."""
        body = self.bodies[robot]
        turned = body.robot.facing * (body.position - body.robot.position) / body.robot.wheel_radius
        return round(turned * WHEEL_COUNTS / (2 * pi)) * 2 * pi / WHEEL_COUNTS

    def tilt(self) -> tuple[float, float]:
        """Return the plane's angle, rad, and angular velocity, rad/s, as measured by an IMU."""
        return self.angle + self.noise.gauss(0.0, TILT_NOISE), self.rate + self.noise.gauss(0.0, RATE_NOISE)

    def encoder(self) -> float:
        """Return the angle measured by the encoder on the plane's axis, rad."""
        return round(self.angle * PLANE_COUNTS / (2 * pi)) * 2 * pi / PLANE_COUNTS
