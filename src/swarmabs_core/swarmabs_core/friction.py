"""Friction of the plane's bearing (eq. frictionModel)."""

from __future__ import annotations

from math import tanh
from typing import NamedTuple


class Friction(NamedTuple):
    """f_f(w) = g1 (tanh(g2 w) - tanh(g3 w)) + g4 tanh(g5 w) + g6 w.

    Amplitudes of the Stribeck and of the Coulomb term are in N m, steepness of the hyperbolic tangents is in s/rad,
    viscous friction in N m s/rad.
    """

    g1: float
    g2: float
    g3: float
    g4: float
    g5: float
    g6: float

    def torque(self, angular_velocity: float) -> float:
        """Return the friction torque, N m, at an angular velocity in rad/s."""
        w = angular_velocity
        return self.g1 * (tanh(self.g2 * w) - tanh(self.g3 * w)) + self.g4 * tanh(self.g5 * w) + self.g6 * w

    def slope_at_rest(self) -> float:
        """Return df_f/dw at w = 0, N m s/rad: it sets how stiff the plane is near rest."""
        return self.g1 * (self.g2 - self.g3) + self.g4 * self.g5 + self.g6
