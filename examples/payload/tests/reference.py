"""The payload in continuous time: a rigid body under rotors whose thrusts follow their commands with a lag.

    m p'' = R e3 F - m g e3 + wind - 0.4 p'    J w' = tau - w x J w - 0.05 w    a = (F, tau) = sum B_i f_i

with R = Rz(yaw) Ry(pitch) Rx(roll), w in the body's axes, B_i = (1, y_i, -x_i, kappa s_i). The parent's state is
position, velocity, (roll, pitch, yaw) and w. The coordinate of a rotor is its thrust f_i; its command f_i + T_i f_i' is
between 0 and `highest`.
"""

from dataclasses import dataclass

import numpy as np
from examples.reference_tools import GRAVITY, Array, Constants, Law, Swarm, System
from numpy.typing import NDArray


def smooth(time: float, begin: float, end: float, way: float) -> tuple[float, float, float]:
    """Return a step of degree 5 and its first two derivatives."""
    u, d = min(max((time - begin) / (end - begin), 0.0), 1.0), end - begin
    first, second = 30.0 * u**2 * (1.0 - u) ** 2, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)
    return way * u**3 * (10.0 - 15.0 * u + 6.0 * u * u), way * first / d, way * second / d**2


@dataclass
class Payload(System):
    """Parameters of the payload and its controller.

    Of limits there are "none", they "clip" each command, or limited rotors "leave" their part to the others.
    """

    mass: float = 12.0
    inertias: tuple[float, float, float] = (1.3, 1.3, 2.4)
    drag: float = 0.4
    angular_drag: float = 0.05
    reaction: float = 0.016
    wind: tuple[float, float, float] = (3.0, 2.0, 1.0)
    """Amplitudes of the wind's force along x, y and z, N."""
    yaw: bool = True
    """Whether the torque about z belongs to a (k = 4) or vanishes (k = 3)."""
    fading: float = 2.0
    """The rotors' own motion is -fading f."""
    limits: str = "none"
    tilt: float = 0.25
    highest: float = 1.0e9
    """Bound of every request: F within 0 and this, torques within this both ways."""

    def __post_init__(self) -> None:
        k = 4 if self.yaw else 3
        self.parent = np.zeros(12)
        self.bounds = (np.array([0.0, *[-self.highest] * (k - 1)]), np.full(k, self.highest))
        self.completion = np.zeros(k), np.eye(k), np.zeros((k, k, k))

    def jacobian(self, q: Array, c: Constants) -> Array:
        """Return B_i."""
        rows = [np.ones(len(q)), c["y"], -c["x"], self.reaction * c["spin"]]
        return np.stack(rows[: len(self.completion[0])], axis=1)[:, :, None]

    def contribution(self, q: Array, c: Constants) -> Array:
        """Return B_i f_i."""
        return self.jacobian(q, c)[:, :, 0] * q

    def weight(self, c: Constants) -> Array:
        """Return 1 for every rotor."""
        return np.ones_like(c["x"])

    def own_motion(self, q: Array) -> Array:
        """Return -fading f: thrusts that cancel each other fade away."""
        return -self.fading * q

    def limited(self, u: Array, law: Law) -> Array:
        """Return the rates of the thrusts with commands within their limits.

        With "leave" they are clip(xi + W^-1 B^T y), which is the optimality condition of the least sum W (u - xi)^2
        within the limits that has a' as wanted; damped Newton steps find y. Where no rates within the limits sum up to
        a', the term regular |y|^2 leaves them with the least miss.
        """
        if self.limits == "none":
            return u
        lag, top = law.constants["time_constant"][:, None], law.constants["highest"][:, None]
        low, high, on = -law.q / lag, (top - law.q) / lag, law.counted
        if self.limits == "clip":
            return np.clip(u, low, high)
        flat, pull, dual, regular = law.jacobian[on, :, 0], law.pull[on, 0], law.dual, 1e-10 * len(u)

        def slope(y: Array) -> tuple[Array, NDArray[np.bool_]]:
            """Return the gradient of the convex function that y minimises, and who is within the limits."""
            free = law.drift[on, 0] + pull @ y
            rates = np.clip(free, low[on, 0], high[on, 0])
            return flat.T @ rates + regular * y - law.demand, rates == free

        for _ in range(60):
            gradient, inner = slope(dual)
            if np.abs(gradient).max() < 1e-10 * max(1.0, np.abs(law.demand).max()):
                break
            step = -np.linalg.solve(flat[inner].T @ pull[inner] + regular * np.eye(len(dual)), gradient)
            # The least along the step, where the slope along it vanishes.
            scale, tried = 1.0, slope(dual + step)[0] @ step
            for halving in range(40 if tried > 1e-12 * abs(gradient @ step) else 0):
                scale -= 0.5 ** (halving + 1) * float(np.sign(slope(dual + scale * step)[0] @ step))
            dual = dual + scale * step
        return np.clip(law.drift + law.pull @ dual, low, high)

    def wanted(self, time: float) -> tuple[Array, Array, Array]:
        """Return the position to follow, and its first two derivatives."""
        x, z = smooth(time, 3.0, 7.0, 1.5), smooth(time, 0.5, 4.0, 2.0)
        p, v, a = (np.array([along, 0.0, up]) for along, up in zip(x, z, strict=True))
        return p, v, a

    def ask(self, time: float, x: Array, z: Array, swarm: Swarm) -> tuple[Array, Array]:
        """Return the force and the torques asked for."""
        del swarm
        p, v, (roll, pitch, yaw), w = np.split(x, 4)
        goal, goal_rate, goal_acceleration = self.wanted(time)
        e, e_rate = goal - p, goal_rate - v
        force = (
            self.mass * (GRAVITY + goal_acceleration[2] + 3.6 * e_rate[2] + 4.0 * e[2]) / (np.cos(roll) * np.cos(pitch))
        )
        ax, ay = (goal_acceleration + 1.6 * e_rate + e)[:2]
        ahead, left = np.cos(yaw) * ax + np.sin(yaw) * ay, np.cos(yaw) * ay - np.sin(yaw) * ax
        asked = np.clip([-left / GRAVITY, ahead / GRAVITY], -self.tilt, self.tilt)
        turn = np.array([*(25.0 * (asked - [roll, pitch]) - 9.0 * w[:2]), -1.5 * yaw - 2.2 * w[2]])
        return np.array([force, *(np.array(self.inertias) * turn)])[: len(self.completion[0])], z

    def derivative(self, time: float, x: Array, swarm: Swarm) -> Array:
        """Return the derivatives of position, velocity, angles and body rates."""
        _, v, (roll, pitch, yaw), w = np.split(x, 4)
        inertia, torque = np.array(self.inertias), np.zeros(3)
        torque[: swarm.value.size - 1] = swarm.value[1:]
        cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
        axis = np.array([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])
        gust = np.array(self.wind) * np.sin([0.7 * time, 0.5 * time + 1.0, 0.9 * time])
        acceleration = (swarm.value[0] * axis + gust - self.drag * v) / self.mass - [0.0, 0.0, GRAVITY]
        turn = sr * w[1] + cr * w[2]
        angles = np.array([w[0] + sp / cp * turn, cr * w[1] - sr * w[2], turn / cp])
        return np.concatenate(
            [v, acceleration, angles, (torque - np.cross(w, inertia * w) - self.angular_drag * w) / inertia]
        )
