"""The ship in continuous time: a hull that rolls in waves, and trolleys on lanes across it.

    (J + J_s) r'' + (J_s' + c) r' + k r = -cos(r) tau_s - tau_w(t)       tau_s = g sum m p,  J_s = sum m p^2

The request is tau = (k_1 r + k_2 r' - tau_w^)/cos r, with the momentum observer tau_w^ = -L (P - z), P = (J + J_sd) r',
z' = -c r' - k r - cos(r) tau_sd + L (P - z). The wave is known to the hull alone.
"""

from dataclasses import dataclass

import numpy as np
from examples.reference_tools import GRAVITY, Array, Constants, Swarm, System


@dataclass
class Ship(System):
    """Parameters of the ship and its controller; with no rate gain and no estimate it is the ship without control."""

    inertia: float = 4.0e4
    damping: float = 5.4e3
    stiffness: float = 5.0e4
    roll: float = 0.15
    roll_rate: float = 0.0
    roll_gain: float = 0.0
    rate_gain: float = 4.0e4
    estimate_bandwidth: float = 10.0
    with_estimate: bool = True
    torque_bound: float = 8000.0
    spread: float = 1.0e-5
    least_inertia: float = 100.0
    waves: tuple[tuple[float, float, float], ...] = ((1500.0, 0.11, 0.0), (2500.0, 0.15, 1.0), (1200.0, 0.19, 2.0))
    """Amplitude (N m), frequency (Hz) and phase (rad) of each."""
    growth: float = 5.0
    """Time in which the waves grow from nothing, s."""

    def __post_init__(self) -> None:
        self.parent = np.array([self.roll, self.roll_rate])
        self.estimate = np.array([(self.inertia + self.least_inertia) * self.roll_rate])
        self.bounds = (np.array([-self.torque_bound]), np.array([self.torque_bound]))
        self.completion = (
            np.array([0.0, self.least_inertia]),
            np.array([[1.0], [0.0]]),
            np.array([[[0.0]], [[self.spread]]]),
        )

    def wave(self, time: float) -> float:
        """Return the torque of the waves, N m."""
        torque = sum(a * np.sin(2.0 * np.pi * f * time + phase) for a, f, phase in self.waves)
        return min(time / self.growth, 1.0) * torque

    def contribution(self, q: Array, c: Constants) -> Array:
        """Return g m p and m p^2."""
        m, p = c["mass"], q[:, 0]
        return np.stack([GRAVITY * m * p, m * p * p], axis=1)

    def jacobian(self, q: Array, c: Constants) -> Array:
        """Return g m and 2 m p."""
        m, p = c["mass"], q[:, 0]
        return np.stack([GRAVITY * m, 2.0 * m * p], axis=1)[:, :, None]

    def curvature(self, v: Array, c: Constants) -> Array:
        """Return 0 and 2 m p'^2."""
        return np.stack([0.0 * v[:, 0], 2.0 * c["mass"] * v[:, 0] ** 2], axis=1)

    def ask(self, time: float, x: Array, z: Array, swarm: Swarm) -> tuple[Array, Array]:
        """Return the torque asked for and the rate of the observer's state."""
        del time
        (roll, rate), (torque, inertia) = x, swarm.wanted
        lead = self.estimate_bandwidth * ((self.inertia + inertia) * rate - z)
        z_rate = -self.damping * rate - self.stiffness * roll - np.cos(roll) * torque + lead
        estimate = -lead if self.with_estimate else 0.0 * lead
        return (self.roll_gain * roll + self.rate_gain * rate - estimate) / np.cos(roll), z_rate

    def derivative(self, time: float, x: Array, swarm: Swarm) -> Array:
        """Return (r', r'')."""
        (roll, rate), (torque, inertia), inertia_rate = x, swarm.value, swarm.rate[1]
        moment = -np.cos(roll) * torque - self.wave(time) - (inertia_rate + self.damping) * rate - self.stiffness * roll
        return np.array([rate, moment / (self.inertia + inertia)])
