"""The plate in continuous time: a Hooke joint with axes alpha and beta, and robots that move on it in two dimensions.

The state is (alpha, beta, pi_alpha, pi_beta), with the momenta

    pi = M (alpha', beta') + (s h, 0)       M = [[c^2 (J1+Iyy) + s^2 (J3+Ixx+Iyy), -c Ixy], [-c Ixy, J2+Ixx]]

with c = cos(beta), s = sin(beta) and the robots' spin h = sum m (x y' - y x') in the plane of the plate.
"""

from dataclasses import dataclass

import numpy as np
from examples.reference_tools import GRAVITY, Array, Constants, Swarm, System


@dataclass
class Plate(System):
    """Parameters of the plate and its controller."""

    inertias: tuple[float, float, float] = (3.3, 3.3, 6.6)
    friction: tuple[float, float, float, float, float, float] = (0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
    angles: tuple[float, float] = (0.10, -0.08)
    disturbance: tuple[float, float] = (0.1, 0.1)
    """Amplitudes of d_alpha = a sin(0.5 t) and d_beta = a cos(0.7 t), N m."""
    references: tuple[tuple[float, float], tuple[float, float]] = ((0.12, 0.4), (0.10, 0.25))
    """Amplitude (rad) and angular frequency (rad/s) of the sine that each axis follows."""
    kp: float = 30.0
    kd: float = 15.0
    torque_bound: float = 6.0
    spread: float = 1.15 / (GRAVITY**2 * 4.8)
    least_inertia: float = 0.15

    def __post_init__(self) -> None:
        self.parent = np.array([*self.angles, 0.0, 0.0])
        self.bounds = (np.full(2, -self.torque_bound), np.full(2, self.torque_bound))
        form = np.zeros((5, 2, 2))
        form[2, 0, 0] = form[3, 1, 1] = self.spread
        form[4, 0, 1] = form[4, 1, 0] = 0.5 * self.spread
        self.completion = self.least_inertia * np.array([0.0, 0.0, 1.0, 1.0, 0.0]), np.eye(5, 2), form

    def contribution(self, q: Array, c: Constants) -> Array:
        """Return m (g x, g y, x^2, y^2, x y)."""
        x, y = q.T
        return c["mass"][:, None] * np.stack([GRAVITY * x, GRAVITY * y, x * x, y * y, x * y], axis=1)

    def jacobian(self, q: Array, c: Constants) -> Array:
        """Return the derivatives with respect to x and y."""
        jacobian = np.zeros((len(q), 5, 2))
        jacobian[:, 0, 0] = jacobian[:, 1, 1] = GRAVITY
        jacobian[:, 2, 0], jacobian[:, 3, 1] = 2.0 * q.T
        jacobian[:, 4, 1], jacobian[:, 4, 0] = q.T
        return c["mass"][:, None, None] * jacobian

    def curvature(self, v: Array, c: Constants) -> Array:
        """Return m (0, 0, 2 x'^2, 2 y'^2, 2 x' y')."""
        x, y = v.T
        return 2.0 * c["mass"][:, None] * np.stack([0.0 * x, 0.0 * y, x * x, y * y, x * y], axis=1)

    def spin(self, q: Array, v: Array, c: Constants) -> float:
        """Return h."""
        return float(c["mass"] @ (q[:, 0] * v[:, 1] - q[:, 1] * v[:, 0]))

    def mass_matrix(self, beta: float, inertia: Array) -> Array:
        """Return M, inertia being (Ixx, Iyy, Ixy)."""
        (j1, j2, j3), (xx, yy, xy), c, s = self.inertias, inertia, np.cos(beta), np.sin(beta)
        return np.array([[c * c * (j1 + yy) + s * s * (j3 + xx + yy), -c * xy], [-c * xy, j2 + xx]])

    def rates(self, x: Array, swarm: Swarm) -> Array:
        """Return (alpha', beta')."""
        return np.linalg.solve(self.mass_matrix(x[1], swarm.value[2:]), x[2:] - [np.sin(x[1]) * swarm.spin, 0.0])

    def rub(self, rate: Array) -> Array:
        """Return the torque of the friction of an axis."""
        g1, g2, g3, g4, g5, g6 = self.friction
        return g1 * (np.tanh(g2 * rate) - np.tanh(g3 * rate)) + g4 * np.tanh(g5 * rate) + g6 * rate

    def wanted(self, time: float) -> tuple[Array, Array, Array]:
        """Return the angles to follow, and their first two derivatives."""
        a, f = np.array(self.references).T
        return a * np.sin(f * time), a * f * np.cos(f * time), -a * f * f * np.sin(f * time)

    def ask(self, time: float, x: Array, z: Array, swarm: Swarm) -> tuple[Array, Array]:
        """Return (a_1, a_2), the moments m g x and m g y asked for."""
        goal, goal_rate, goal_acceleration = self.wanted(time)
        inertia = np.array(self.inertias[:2]) + self.least_inertia
        torque = (
            self.kp * (goal - x[:2])
            + self.kd * (goal_rate - self.rates(x, swarm))
            + inertia * goal_acceleration
            + self.rub(goal_rate)
        )
        alpha, beta = x[:2]
        first = torque[1] / (np.cos(alpha) * np.cos(beta))
        return np.array([first, -(torque[0] + first * np.sin(alpha) * np.sin(beta)) / np.cos(alpha)]), z

    def derivative(self, time: float, x: Array, swarm: Swarm) -> Array:
        """Return the angles' rates and the torques on the momenta."""
        (alpha, beta), (a1, a2, xx, _, xy), h = x[:2], swarm.value, swarm.spin
        rate, c, s, (j1, _, j3) = self.rates(x, swarm), np.cos(beta), np.sin(beta), self.inertias
        d = np.array(self.disturbance) * [np.sin(0.5 * time), np.cos(0.7 * time)]
        weight = np.array([-(a2 * np.cos(alpha) + a1 * np.sin(alpha) * s), a1 * np.cos(alpha) * c])
        gyration = s * c * (j3 - j1 + xx) * rate[0] ** 2 + s * xy * rate[0] * rate[1] + c * h * rate[0]
        return np.concatenate([rate, weight - self.rub(rate) + d + [0.0, gyration]])

    def changed(self, x: Array, before: Swarm, after: Swarm) -> Array:
        """Return the momenta with which the plate's rates are as before."""
        momenta = self.mass_matrix(x[1], after.value[2:]) @ self.rates(x, before)
        return np.concatenate([x[:2], momenta + np.sin(x[1]) * after.spin * np.eye(2)[0]])
