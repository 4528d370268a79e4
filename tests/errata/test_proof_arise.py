"""thm. ARISE_SI_sys, app. ProofARISE_SI, lem. NisBounded, EisBounded, PIsPosDef, and section ARISE Controller.

Signals of time are given analytically; derivatives are finite differences, integrals quadratures.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, exp, inf, sin, sqrt, tanh
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.integrate import quad
from tests.errata.paper import (
    FRICTION,
    GAINS,
    INERTIA,
    MASS,
    OFFSET,
    POSITION,
    TORQUE_MAX,
    friction,
    manifold,
    slope,
)

from swarmabs_core.controllers.arise import AriseGains, regressor
from swarmabs_core.friction import Friction

if TYPE_CHECKING:
    from collections.abc import Callable

A1, A2, BETA, KS = 1.0, 2.0, 0.5, 1.0
GAMMA = np.array([10.0, 1.0, 1.0, 10.0])
LAM = np.array([INERTIA, FRICTION[0], FRICTION[3], FRICTION[5]])
LAM_0 = np.array([0.4566, 0.009, 0.01, 0.9])
K_TAU = GAINS.k[0]
ETA_3 = min(2.0 * A1 - 1.0, A2 - 1.0, 1.0)
SLOW = Friction(0.01, 2.0, 1.5, 0.02, 3.0, 1.0)
"""Friction of the paper's form, gentle enough for finite differences."""
STEP = 2e-3


@dataclass
class Motion:
    """A plane that does not quite follow its reference, with a swarm that breathes and a disturbance."""

    error: float = 0.1

    def th_d(self, t: float) -> float:
        return 0.5 * sin(0.9 * t)

    def e1(self, t: float) -> float:
        return self.error * (cos(1.3 * t) + 0.4 * t)

    def th(self, t: float) -> float:
        return self.th_d(t) - self.e1(t)

    def js(self, t: float) -> float:
        return 0.2 + 0.1 * sin(0.7 * t)

    def tau_d(self, t: float) -> float:
        return 0.1 * sin(0.5 * t)

    def rate(self, function: Callable[[float], float], t: float, order: int = 1) -> float:
        if order == 0:
            return function(t)
        return slope(lambda s: self.rate(function, s, order - 1), t, 0.03)

    def e2(self, t: float) -> float:
        return self.rate(self.e1, t) + A1 * self.e1(t)

    def r(self, t: float) -> float:
        return self.rate(self.e2, t) + A2 * self.e2(t)

    def y(self, t: float) -> np.ndarray:
        """Y_d by eq. adaptiveTerm."""
        w, dw = self.rate(self.th_d, t), self.rate(self.th_d, t, 2)
        steep = [tanh(g * w) for g in (SLOW.g2, SLOW.g3, SLOW.g5)]
        return np.array([dw, steep[0] - steep[1], steep[2], w])

    def dy(self, t: float) -> np.ndarray:
        return np.array([slope(lambda s, i=i: float(self.y(s)[i]), t, 0.03) for i in range(4)])

    def w_aux(self, t: float) -> float:
        """W of eq. aux_W."""
        inertia = INERTIA + self.js(t)
        return (
            inertia * (self.rate(self.th_d, t, 2) + A1 * self.rate(self.e1, t) + A2 * self.e2(t))
            + self.rate(self.js, t) * self.rate(self.th, t)
            + SLOW.torque(self.rate(self.th, t))
            - float(self.y(t) @ LAM)
        )

    def n(self, t: float) -> float:
        """N: what the rate of (J + J_s) r holds beside adaptation, feedback and coupling."""
        return (
            -float(self.y(t) @ (GAMMA * self.dy(t))) * self.r(t)
            + slope(self.w_aux, t, 0.03)
            - 0.5 * self.rate(self.js, t) * self.r(t)
            + self.e2(t)
            + self.rate(self.tau_d, t)
        )

    def n_d(self, t: float) -> float:
        """N_d of lem. NisBounded."""
        js, djs, ddjs = (self.rate(self.js, t, k) for k in range(3))
        w, dw, ddw = (self.rate(self.th_d, t, k) for k in (1, 2, 3))
        friction_rate = slope(lambda s: SLOW.torque(self.rate(self.th_d, s)), t, 0.03)
        return (
            2.0 * djs * dw
            + (INERTIA + js) * ddw
            + ddjs * w
            + friction_rate
            - float(self.dy(t) @ LAM)
            + self.rate(self.tau_d, t)
        )


T = 0.8


def test_friction_gentle_enough_is_of_the_papers_form() -> None:
    """The adaptive term of the tests' regressor is the package's."""
    motion = Motion()
    rates = tuple(motion.rate(motion.th_d, T, k) for k in (1, 2, 3, 4))
    np.testing.assert_allclose(regressor(SLOW, rates)[0], motion.y(T), rtol=1e-6)
    np.testing.assert_allclose(regressor(SLOW, rates)[1], motion.dy(T), rtol=1e-4)
