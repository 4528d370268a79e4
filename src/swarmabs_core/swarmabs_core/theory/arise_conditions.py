r"""The theorems of a plane under the ARISE controller: ARISE_SI_sys, ARISE_DI_sys and ARISE_noHomo_sys.

The proof needs :math:`|\tilde N| \le c_{max} |z_p|` with :math:`z_p = (e_1, e_2, r)`. For a reference at rest, where
the friction is steepest with slope s, and constant inertia I,

.. math::

    \tilde N = (I (\alpha_1 + \alpha_2) - s) r
             + (1 - I (\alpha_1^2 + \alpha_1 \alpha_2 + \alpha_2^2) + s (\alpha_1 + \alpha_2)) e_2
             + \alpha_1^2 (I \alpha_1 - s) e_1

to first order, so c_max is at least the length of this gradient, and its friction alone, in the direction of r, is s.
Completing the square gives :math:`k_s > c_{max}^2/(4 \eta_3)`; the theorem prints :math:`c_{max}/\eta_3`, its proof
:math:`c_{max}/(4 \eta_3)`. Rates of the inertia only add to c_max, so these conditions are necessary.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf, sqrt
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_core.controllers.arise import Arise
from swarmabs_core.theory.attraction import balls
from swarmabs_core.theory.report import Condition, Form, ParentCheck
from swarmabs_core.theory.swarm_conditions import swarm_conditions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from swarmabs_core.theory.setting import Setting

    Array = NDArray[np.float64]

SAMPLES = 20001
"""Instants at which the reference is looked at."""


@dataclass(frozen=True, slots=True)
class Reference:
    """Bounds along the reference, with the swarm that it would need.

    Parameters
    ----------
    angle, rate : float
        Largest abs(th_d) and abs(th_d'), rad and rad/s.
    printed, printed_rate : float
        zeta of N_d and of its rate as the theorem prints N_d, N m/s and N m/s^2.
    corrected, corrected_rate : float
        The same as lemma NisBounded has it, with the disturbance.
    initial : float
        N_d at the start, N m/s.
    """

    angle: float
    rate: float
    printed: float
    printed_rate: float
    corrected: float
    corrected_rate: float
    initial: float


def reference_bounds(setting: Setting, law: Arise) -> Reference:
    """Return the bounds along the reference from the start to the end of the scenario."""
    times = np.linspace(0.0, setting.duration, SAMPLES)
    angle, w, dw, ddw = (
        np.array(values) for values in list(zip(*map(law.trajectory.derivatives, times.tolist()), strict=True))[:4]
    )
    disturbance = np.array(setting.plane.disturbance.torques(times.tolist()))
    friction = np.array([setting.friction.torque(rate) for rate in w.tolist()])
    inertia = np.full_like(times, setting.manifold.offset)
    for _ in range(5):  # the torque depends weakly on the inertia that belongs to it
        torque = -((setting.plane.inertia + inertia) * dw + friction + disturbance) / np.cos(angle)
        inertia = setting.manifold.curvature * torque**2 + setting.manifold.offset

    def rate(values: Array) -> Array:
        return np.asarray(np.gradient(values, times, edge_order=2))

    inertia_rate = rate(inertia)
    # Y_d' lambda = J th_d''' + the friction's rate, which leaves the swarm's inertia.
    printed = inertia * ddw + inertia_rate * dw
    corrected = inertia * ddw + 2.0 * inertia_rate * dw + rate(inertia_rate) * w + rate(disturbance)

    def largest(values: Array) -> float:
        return float(np.abs(values).max())

    return Reference(
        largest(angle),
        largest(w),
        largest(printed),
        largest(rate(printed)),
        largest(corrected),
        largest(rate(corrected)),
        float(corrected[0]),
    )


def error_gradient(inertia: float, slope: float, alpha1: float, alpha2: float) -> tuple[float, float, float]:
    """Return the derivatives of N~ by e1, e2 and r for a reference at rest and constant inertia.

    Parameters
    ----------
    inertia : float
        J + J_s, kg m^2.
    slope : float
        Of the friction, N m s/rad.
    alpha1, alpha2 : float
        1/s.
    """
    both = alpha1 + alpha2
    return (
        alpha1**2 * (inertia * alpha1 - slope),
        1.0 - inertia * (alpha1 * both + alpha2**2) + slope * both,
        inertia * both - slope,
    )


def printed_bound(inertia: float, largest: float, slope: float, alpha1: float, alpha2: float) -> float:
    """Return c_max = max{c1, c2, c3} of lemma NisBounded with all rates 0, a part of what the lemma prints.

    Parameters
    ----------
    inertia, largest : float
        J and J_max, kg m^2.
    slope, alpha1, alpha2 : float
        As of `error_gradient`.
    """
    total = inertia + largest
    return max(
        total * abs(alpha1 - alpha2) + slope,
        abs(1.0 + total * (alpha2 - alpha1) * alpha2)
        + abs(largest * alpha1 + inertia * alpha1**2 - (alpha1 + alpha2) * slope),
        inertia * alpha1**3 + alpha1**2 * slope,
    )


def check_arise(setting: Setting) -> ParentCheck | None:
    """Evaluate the theorem; None if the parent controller is another one."""
    law = setting.law
    if not isinstance(law, Arise):
        return None
    g, manifold, inertia = law.gains, setting.manifold, setting.plane.inertia
    bounds = reference_bounds(setting, law)
    slope = setting.friction.slope_at_rest()
    eta3 = min(2.0 * g.alpha1 - 1.0, g.alpha2 - 1.0, 1.0)
    gradient = error_gradient(inertia + manifold.offset, slope, g.alpha1, g.alpha2)
    lemma = printed_bound(inertia, manifold.inertia(manifold.torque_max), slope, g.alpha1, g.alpha2)
    length = hypot(*gradient)
    least = max(length, slope)
    ball = _Ball(setting, law, bounds, eta3, slope, least)
    state = ball.initial_state()
    norm = hypot(*state)
    printed, corrected = ball.printed(), ball.corrected()
    conditions = (
        *(Condition(name, form, form, {name: form.value}) for name, form in _simple(law)),
        Condition(
            "beta",
            Form("beta > zeta_Nd + zeta_Nd'/alpha2", g.beta, bounds.printed + bounds.printed_rate / g.alpha2),
            Form("beta > zeta_Nd + zeta_Nd'/alpha2", g.beta, bounds.corrected + bounds.corrected_rate / g.alpha2),
            {
                "zeta_printed": bounds.printed,
                "zeta_rate_printed": bounds.printed_rate,
                "zeta_corrected": bounds.corrected,
                "zeta_rate_corrected": bounds.corrected_rate,
                "alpha2": g.alpha2,
            },
            "the theorem prints N_d without the disturbance and half of the inertia's rates; bounds sampled along the "
            "reference",
        ),
        Condition(
            "ks, friction alone",
            Form("ks > c_max/eta3", g.ks, _over(slope, eta3)),
            Form("ks > c_max^2/(4 eta3)", g.ks, _over(slope * slope / 4.0, eta3)),
            {"ks": g.ks, "c_max": slope, "eta3": eta3, "bound_in_the_proof": _over(slope / 4.0, eta3)},
            _uncovered(g.ks, slope, eta3),
        ),
        Condition(
            "ks, all terms at rest",
            Form("ks > c_max/eta3", g.ks, _over(lemma, eta3)),
            Form("ks > c_max^2/(4 eta3)", g.ks, _over(least * least / 4.0, eta3)),
            {"ks": g.ks, "c_max_printed": lemma, "c_max_corrected": least, "eta3": eta3, "gradient": gradient},
            "c_max is at least the gradient of N~ at rest; rates of the inertia add to it",
        ),
        *swarm_conditions(setting),
        Condition(
            "initial state",
            Form("|(z0, y0)|^2 <= rho^2 eta1/eta2", norm * norm, printed, "<="),
            Form("|(z0, y0)|^2 <= rho^2 eta1/eta2, rho from min, not sum", norm * norm, corrected, "<="),
            {"state": state, "eta3": eta3, "c_max_printed": slope, "c_max_corrected": least},
            "" if corrected > 0.0 else "S is empty, as ks is too small",
        ),
    )
    derivative = Condition(
        "negative derivative",
        Form("eta3 - c_max/(4 ks) > 0", _decay(g.ks, eta3, slope), 0.0),
        Form("eta3 - c_max^2/(4 ks) > 0", _decay(g.ks, eta3, least * least), 0.0),
    )
    square = norm * norm
    # S is a ball: its function is the square of the norm.
    return ParentCheck(
        "ARISE",
        conditions,
        derivative,
        manifold.torque_max,
        bounds.angle,
        printed,
        square,
        (1.0, 1.0),
        balls(square, printed, corrected),
    )


def _decay(ks: float, eta3: float, numerator: float) -> float:
    return eta3 - numerator / (4.0 * ks) if ks > 0.0 else -inf


def _simple(law: Arise) -> tuple[tuple[str, Form], ...]:
    g = law.gains
    return (
        ("alpha1", Form("alpha1 > 1/2", g.alpha1, 0.5)),
        ("alpha2", Form("alpha2 > 1", g.alpha2, 1.0)),
        ("Gamma", Form("Gamma > 0", min(g.gamma), 0.0)),
    )


def _over(value: float, eta3: float) -> float:
    return value / eta3 if eta3 > 0.0 else inf


def _uncovered(ks: float, slope: float, eta3: float) -> str:
    needed = _over(slope * slope / 4.0, eta3)
    if ks > needed:
        return ""
    return (
        f"with ks = {ks:.6g} the ARISE theorem does not cover this run: the friction's slope at rest, "
        f"{slope:.6g} N m s/rad, alone asks for ks > {needed:.6g}"
    )


@dataclass(frozen=True, slots=True)
class _Ball:
    """The ball S of the theorem."""

    setting: Setting
    law: Arise
    bounds: Reference
    eta3: float
    slope: float
    c_max: float

    def initial_state(self) -> tuple[float, ...]:
        """Return e1, e2, r, the errors of the abstract state (with rates for double integrators), lambda~, sqrt P."""
        g, plane, f = self.law.gains, self.setting.plane, self.setting.friction
        angle, rate, acceleration, _, _ = self.law.trajectory.derivatives(0.0)
        e1, de1 = angle - plane.angle, rate - plane.angular_velocity
        e2 = de1 + g.alpha1 * e1
        r = acceleration - self.setting.initial_acceleration + g.alpha1 * de1 + g.alpha2 * e2
        rates = self.setting.initial_error_rate if self.setting.has_double else ()
        estimated = (
            true - guess for true, guess in zip((plane.inertia, f.g1, f.g4, f.g6), g.adaptive_initial, strict=True)
        )
        p = max(0.0, g.beta * abs(e2) - e2 * self.bounds.initial)
        return (e1, e2, r, *self.setting.initial_error, *rates, *estimated, sqrt(p))

    def _coefficients(self) -> tuple[float, float]:
        """Return eta1 and eta2."""
        inertia, manifold = self.setting.plane.inertia, self.setting.manifold
        gamma = self.law.gains.gamma
        largest = 1.0 / min(gamma) if min(gamma) > 0.0 else inf
        return (
            0.5 * min(1.0, inertia + manifold.offset, 1.0 / max(gamma) if max(gamma) > 0.0 else inf),
            0.5 * max(2.0, inertia + manifold.inertia(manifold.torque_max), largest),
        )

    def printed(self) -> float:
        """Return the largest square of the norm as printed, with c_max the slope of the friction."""
        g, k = self.law.gains, self.setting.gains.k
        if g.ks <= 0.0:
            return 0.0
        argument = 2.0 * self.eta3 - self.slope / (2.0 * g.ks) + 2.0 * min(k)
        rho = max(0.0, (argument - k[0]) / (1.0 + g.alpha1))
        eta1, eta2 = self._coefficients()
        return eta1 / eta2 * rho * rho

    def corrected(self) -> float:
        """Return it with V_a weighted by kappa, such that rho_E^2 < 4 kappa a (eta3 - c_max^2/(4 ks)) is used best."""
        g = self.law.gains
        decay = _decay(g.ks, self.eta3, self.c_max**2)
        if decay <= 0.0:
            return 0.0
        eta1, eta2 = self._coefficients()
        best = 0.0
        for exponent in range(-60, 121):
            weight = 10.0 ** (exponent / 20.0)
            low, high, swarm_decay, at_zero = self._swarm()
            rho = (2.0 * sqrt(weight * swarm_decay * decay) - at_zero - self.bounds.rate) / (1.0 + g.alpha1)
            ratio = min(eta1, weight * low) / max(eta2, weight * high)
            best = max(best, ratio * max(0.0, rho) ** 2)
        return best

    def _swarm(self) -> tuple[float, float, float, float]:
        """Return least and largest coefficient of V_a, decay of V_a and the gain of e_tau' in E, of the slower part."""
        gains, epsilon = self.setting.gains, self.setting.epsilon
        parts = []
        if self.setting.has_single:
            parts.append((0.5, 0.5, min(gains.k), gains.k[0]))
        if self.setting.has_double:
            for kp, kd in zip(gains.kp, gains.kd, strict=True):
                m1 = np.linalg.eigvalsh([[kp, epsilon], [epsilon, 1.0]])
                m2 = np.linalg.eigvalsh([[epsilon * kp, epsilon * kd / 2.0], [epsilon * kd / 2.0, kd - epsilon]])
                parts.append((float(m1[0]) / 2.0, float(m1[1]) / 2.0, float(m2[0]), 1.0))
        low, high, decay, gain = zip(*parts, strict=True)
        return min(low), max(high), min(decay), max(gain)
