"""Robots that slide exactly along the paths of a simulation: what MuJoCo's plane does under the same swarm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from mujoco_world import Chassis, Friction, Physics, Plank, build, drag

if TYPE_CHECKING:
    from numpy.typing import NDArray

Cubic = tuple[float, float, float, float]
"""Position by time since the start of a period, m: coefficients of t^0 to t^3."""


class Sliders:
    """A plank with sliders that move as prescribed.

    MuJoCo computes the plank's acceleration and the forces between plank and sliders; nothing of the equation of the
    plane is given to it.

    Parameters
    ----------
    chassis : sequence of Chassis
        The robots; their bases are sliders.
    plank, physics : Plank, Physics
        The rest of the world.
    friction : tuple of float
        g1 to g6 of the bearing.
    angle : float
        Initial angle of the plank, rad.
    """

    def __init__(
        self, chassis: Sequence[Chassis], plank: Plank, physics: Physics, friction: Friction, angle: float
    ) -> None:
        self.model = build(tuple(chassis), plank, physics, angle)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[0] = angle
        self._friction = friction
        self._paths: NDArray[np.float64] = np.zeros((4, len(chassis)))
        self._begin = 0.0

    def advance(self, paths: Sequence[Cubic], period: float) -> tuple[float, float]:
        """Move the sliders along paths for a period, s; return the plank's angle (rad) and angular velocity (rad/s)."""
        data = self.data
        self._paths, self._begin = np.array(paths).T, float(data.time)
        before = data.qvel[1:].copy()
        data.qpos[1:], data.qvel[1:] = self._paths[0], self._paths[1]
        mujoco.mj_forward(self.model, data)
        mass = self._mass(data)
        # A sudden change of speed is an impulse along the lane, which acts on the plank at the height of the mass.
        data.qvel[0] -= float(mass[0, 1:] @ (data.qvel[1:] - before)) / mass[0, 0]
        with self._prescribed():
            for _ in range(round(period / self.model.opt.timestep)):
                mujoco.mj_step(self.model, data)
        return float(data.qpos[0]), float(data.qvel[0])

    def _mass(self, data: Any) -> NDArray[np.float64]:
        mass = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, data, mass)
        return mass

    @contextmanager
    def _prescribed(self) -> Iterator[None]:
        """Let every stage of MuJoCo's integrator apply the forces that give the sliders their accelerations."""

        def control(_model: Any, data: Any) -> None:
            t = data.time - self._begin
            acceleration = 2.0 * self._paths[2] + 6.0 * t * self._paths[3]
            mass, bias = self._mass(data), data.qfrc_bias
            friction = drag(self._friction, float(data.qvel[0]))
            turning = (-friction - bias[0] - mass[0, 1:] @ acceleration) / mass[0, 0]
            data.qfrc_applied[0] = -friction
            data.qfrc_applied[1:] = mass[1:, 0] * turning + mass[1:, 1:] @ acceleration + bias[1:]

        mujoco.set_mjcb_control(control)
        try:
            yield
        finally:
            mujoco.set_mjcb_control(None)
