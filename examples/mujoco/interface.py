"""What is known of a rig outside of it: its robots, and what its sensors measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

WATCHDOG = 0.2
"""Time without a command after which a base stops by itself, s."""

Source = Literal["odometry from its start", "localisation", "wheel"]


@dataclass(frozen=True, slots=True)
class Robot:
    """A robot.

    Attributes
    ----------
    id : int
        Its number in the swarm.
    kind : str
        ``single_integrator``: takes velocities; ``double_integrator``: takes forces.
    mass, damping : float
        Mass, kg, and viscous damping of its motion, N s/m.
    position : float
        Where it is put down on its lane, m.
    facing : float
        1 along the lane, -1 against it.
    source : str
        The sensor of its position.
    wheel_radius : float
        Radius of its wheels, m.
    """

    id: int
    kind: Literal["single_integrator", "double_integrator"]
    mass: float
    damping: float
    position: float
    facing: float
    source: Source
    wheel_radius: float = 0.03

    @property
    def forced(self) -> bool:
        """Whether it is driven by force."""
        return self.kind == "double_integrator"


class Reading(NamedTuple):
    """Measurement of a robot: position (m) and velocity (m/s) along its lane, forward turn of its wheels (rad)."""

    position: float
    velocity: float
    turned: float


class Readings(NamedTuple):
    """Measurements of all sensors.

    Attributes
    ----------
    age : float
        Time since they were measured, s.
    encoder : float
        Angle by the encoder on the plane's axis, rad.
    tilt : tuple of float
        Angle, rad, and angular velocity, rad/s, by the robots' IMUs.
    robots : dict
        Measurements of the robots by id.
    """

    age: float
    encoder: float
    tilt: tuple[float, float]
    robots: dict[int, Reading]
