r"""The theorems for a plane under the ARISE controller: ARISE_SI_sys, ARISE_DI_sys and ARISE_noHomo_sys.

The proof requires :math:`|\tilde N| \le c_{max} |z_p|` with :math:`z_p = (e_1, e_2, r)`. For a reference at rest, where
the slope s of the friction is largest, and constant inertia I,

.. math::

    \tilde N = (I (\alpha_1 + \alpha_2) - s) r
             + (1 - I (\alpha_1^2 + \alpha_1 \alpha_2 + \alpha_2^2) + s (\alpha_1 + \alpha_2)) e_2
             + \alpha_1^2 (I \alpha_1 - s) e_1

to first order, so c_max is at least the norm of this gradient; friction alone contributes s in the direction of r.
Completing the square gives :math:`k_s > c_{max}^2/(4 \eta_3)`; the theorem prints :math:`c_{max}/\eta_3`, its proof
:math:`c_{max}/(4 \eta_3)`. Rates of the inertia can only increase c_max, so these conditions are necessary.
"""

from __future__ import annotations

from math import cos, hypot, inf, sin, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from swarmabs_core.controllers import Arise
from swarmabs_core.theory.error_dynamics import chosen_epsilon, gain_conditions
from swarmabs_core.theory.report import Condition, Form, ParentCheck
from swarmabs_core.theory.state_feedback import balls

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from swarmabs_core.theory.setting import Setting

    Array = NDArray[np.float64]

SAMPLES = 20001
"""Number of instants at which the reference is sampled."""
FRICTION_ALONE = "ks, friction alone"
"""Name of the condition that decides: without it, the other conditions on ks and on the initial state cannot hold."""


class Reference(NamedTuple):
    """Bounds along the reference, with the swarm it requires; zeta bounds N_d (N m/s) or its rate (N m/s^2)."""

    angle: float  # largest |th_d|, rad
    rate: float  # largest |th_d'|, rad/s
    printed: float  # zeta as the theorem prints N_d
    printed_rate: float
    corrected: float  # zeta as in lemma NisBounded, with the disturbance
    corrected_rate: float
    initial: float  # N_d at the start, N m/s


def reference_bounds(setting: Setting, law: Arise) -> Reference:
    """Return the bounds along the reference from the start to the end of the scenario."""
    times = np.linspace(0.0, setting.duration, SAMPLES)
    angle, w, dw, ddw = (
        np.array(values) for values in list(zip(*map(law.trajectory.derivatives, times.tolist()), strict=True))[:4]
    )
    disturbance = setting.plane.disturbance.torque(times, np.sin) - setting.weight * np.sin(angle)
    needed = disturbance - setting.compensated_weight * np.sin(angle)
    friction = setting.plane.friction.torque(w, np.tanh)
    inertia = np.full_like(times, setting.manifold.offset)
    for _ in range(5):  # fixed-point iteration: the torque depends weakly on its inertia
        torque = -((setting.body_inertia + inertia) * dw + friction + needed) / np.cos(angle)
        inertia = setting.manifold.curvature * torque**2 + setting.manifold.offset

    def rate(values: Array) -> Array:
        return np.asarray(np.gradient(values, times, edge_order=2))

    inertia_rate = rate(inertia)
    # Y_d' lambda = J th_d''' + the rate of the friction; the terms of the swarm's inertia remain.
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


def error_gradient(
    inertia: float, slope: float, alpha1: float, alpha2: float, weight: float = 0.0
) -> tuple[float, float, float]:
    """Return the derivatives of N~ by e1, e2 and r for a reference at rest at 0 and constant inertia J + J_s (kg m^2).

    `slope` is that of the friction (N m s/rad); the alphas are in 1/s; `weight` is g H of masses above the axis (N m).
    """
    both = alpha1 + alpha2
    return (
        alpha1**2 * (inertia * alpha1 - slope) - alpha1 * weight,
        1.0 - inertia * (alpha1 * both + alpha2**2) + slope * both + weight,
        inertia * both - slope,
    )


def printed_bound(inertia: float, largest: float, slope: float, alpha1: float, alpha2: float) -> float:
    """Return c_max = max{c1, c2, c3} of lemma NisBounded with all rates 0, a lower bound of the printed one.

    `inertia` and `largest` are J and J_max (kg m^2); the others are as in `error_gradient`.
    """
    total = inertia + largest
    return max(
        total * abs(alpha1 - alpha2) + slope,
        abs(1.0 + total * (alpha2 - alpha1) * alpha2)
        + abs(largest * alpha1 + inertia * alpha1**2 - (alpha1 + alpha2) * slope),
        inertia * alpha1**3 + alpha1**2 * slope,
    )


def check_arise(setting: Setting) -> ParentCheck | None:
    """Evaluate the theorem; return None for other parent controllers."""
    law = setting.law
    if not isinstance(law, Arise):
        return None
    g, manifold, inertia = law.gains, setting.manifold, setting.body_inertia
    bounds = reference_bounds(setting, law)
    slope = setting.plane.friction.slope_at_rest()
    eta3 = min(2.0 * g.alpha1 - 1.0, g.alpha2 - 1.0, 1.0)
    gradient = error_gradient(inertia + manifold.offset, slope, g.alpha1, g.alpha2, setting.weight)
    lemma = printed_bound(inertia, manifold.inertia(manifold.torque_max), slope, g.alpha1, g.alpha2)
    least = max(hypot(*gradient), slope)
    state = _initial_state(setting, law, bounds)
    norm = hypot(*state)
    square = norm * norm
    printed = _printed_ball(setting, law, eta3, slope)
    corrected = _corrected_ball(setting, law, _decay(g.ks, eta3, least**2), bounds.rate)
    needed = _over(slope * slope / 4.0, eta3)
    uncovered = (
        f"with ks = {g.ks:.6g} the ARISE theorem does not cover this run: the friction's slope at rest, "
        f"{slope:.6g} N m s/rad, alone requires ks > {needed:.6g}"
    )
    simple = (
        ("alpha1", Form("alpha1 > 1/2", g.alpha1, 0.5)),
        ("alpha2", Form("alpha2 > 1", g.alpha2, 1.0)),
        ("Gamma", Form("Gamma > 0", min(g.gamma), 0.0)),
    )
    conditions = (
        *(Condition(name, form, form, {name: form.value}) for name, form in simple),
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
            "the theorem prints N_d without the disturbance and half of the inertia's rates; the bounds are sampled "
            "along the reference",
        ),
        Condition(
            FRICTION_ALONE,
            Form("ks > c_max/eta3", g.ks, _over(slope, eta3)),
            Form("ks > c_max^2/(4 eta3)", g.ks, needed),
            {"ks": g.ks, "c_max": slope, "eta3": eta3, "bound_in_the_proof": _over(slope / 4.0, eta3)},
            "" if g.ks > needed else uncovered,
        ),
        Condition(
            "ks, all terms at rest",
            Form("ks > c_max/eta3", g.ks, _over(lemma, eta3)),
            Form("ks > c_max^2/(4 eta3)", g.ks, _over(least * least / 4.0, eta3)),
            {"ks": g.ks, "c_max_printed": lemma, "c_max_corrected": least, "eta3": eta3, "gradient": gradient},
            "c_max is at least the gradient of N~ at rest; rates of the inertia increase it",
        ),
        *gain_conditions(setting),
        Condition(
            "initial state",
            Form("|(z0, y0)|^2 <= rho^2 eta1/eta2", square, printed, "<="),
            Form("|(z0, y0)|^2 <= rho^2 eta1/eta2, rho from min, not sum", square, corrected, "<="),
            {"state": state, "eta3": eta3, "c_max_printed": slope, "c_max_corrected": least},
            "" if corrected > 0.0 else "S is empty because ks is too small",
        ),
    )
    # S is a ball, the level set of the squared norm.
    return ParentCheck(
        "ARISE",
        conditions,
        derivative=Condition(
            "negative derivative",
            Form("eta3 - c_max/(4 ks) > 0", _decay(g.ks, eta3, slope), 0.0),
            Form("eta3 - c_max^2/(4 ks) > 0", _decay(g.ks, eta3, least * least), 0.0),
        ),
        torque=manifold.torque_max,
        largest_angle=bounds.angle,
        level=printed,
        energy=square,
        growths=(1.0, 1.0),
        attraction=balls(square, printed, corrected),
    )


def _decay(ks: float, eta3: float, numerator: float) -> float:
    return eta3 - numerator / (4.0 * ks) if ks > 0.0 else -inf


def _over(value: float, eta3: float) -> float:
    return value / eta3 if eta3 > 0.0 else inf


def _initial_state(setting: Setting, law: Arise, bounds: Reference) -> tuple[float, ...]:
    """Return e1, e2, r, the errors of the abstract state (with rates for double integrators), lambda~ and sqrt P."""
    g, plane, f, swarm = law.gains, setting.plane, setting.plane.friction, setting.initial
    opposing = (
        cos(plane.angle) * swarm.torque
        + swarm.inertia_rate * plane.angular_velocity
        + f.torque(plane.angular_velocity)  # without the disturbance, which is 0 at the start
        - plane.gravity * setting.moment * sin(plane.angle)
    )
    angle, rate, acceleration, _, _ = law.trajectory.derivatives(0.0)
    e1, de1 = angle - plane.angle, rate - plane.angular_velocity
    e2 = de1 + g.alpha1 * e1
    r = acceleration + opposing / (setting.body_inertia + swarm.inertia) + g.alpha1 * de1 + g.alpha2 * e2
    rates = setting.initial_error_rate if setting.has_double else ()
    estimated = (
        true - guess for true, guess in zip((setting.body_inertia, f.g1, f.g4, f.g6), g.adaptive_initial, strict=True)
    )
    p = max(0.0, g.beta * abs(e2) - e2 * bounds.initial)
    return (e1, e2, r, *setting.initial_error, *rates, *estimated, sqrt(p))


def _coefficients(setting: Setting, law: Arise) -> tuple[float, float]:
    """Return eta1 and eta2 of the ball S."""
    inertia, manifold, gamma = setting.body_inertia, setting.manifold, law.gains.gamma
    smallest = 1.0 / max(gamma) if max(gamma) > 0.0 else inf
    largest = 1.0 / min(gamma) if min(gamma) > 0.0 else inf
    return (
        0.5 * min(1.0, inertia + manifold.offset, smallest),
        0.5 * max(2.0, inertia + manifold.inertia(manifold.torque_max), largest),
    )


def _printed_ball(setting: Setting, law: Arise, eta3: float, slope: float) -> float:
    """Return the largest squared norm in the printed S, with the slope of the friction as c_max."""
    g, k = law.gains, setting.gains.k
    if g.ks <= 0.0:
        return 0.0
    argument = 2.0 * eta3 - slope / (2.0 * g.ks) + 2.0 * min(k)
    rho = max(0.0, (argument - k[0]) / (1.0 + g.alpha1))
    eta1, eta2 = _coefficients(setting, law)
    return eta1 / eta2 * rho * rho


def _corrected_ball(setting: Setting, law: Arise, decay: float, reference_rate: float) -> float:
    """Return the largest squared norm in S with V_a weighted by kappa, optimised under rho_E^2 < 4 kappa a decay."""
    if decay <= 0.0:
        return 0.0
    eta1, eta2 = _coefficients(setting, law)
    low, high, swarm_decay, at_zero = _slower_part(setting)
    best = 0.0
    for exponent in range(-60, 121):
        weight = 10.0 ** (exponent / 20.0)
        rho = (2.0 * sqrt(weight * swarm_decay * decay) - at_zero - reference_rate) / (1.0 + law.gains.alpha1)
        ratio = min(eta1, weight * low) / max(eta2, weight * high)
        best = max(best, ratio * max(0.0, rho) ** 2)
    return best


def _slower_part(setting: Setting) -> tuple[float, float, float, float]:
    """Return the worst values over both parts: coefficients and decay of V_a, and the gain of e_tau' in E."""
    gains, epsilon = setting.gains, chosen_epsilon(setting.gains)
    parts = []
    if setting.has_single:
        parts.append((0.5, 0.5, min(gains.k), gains.k[0]))
    if setting.has_double:
        for kp, kd in zip(gains.kp, gains.kd, strict=True):
            m1 = np.linalg.eigvalsh([[kp, epsilon], [epsilon, 1.0]])
            m2 = np.linalg.eigvalsh([[epsilon * kp, epsilon * kd / 2.0], [epsilon * kd / 2.0, kd - epsilon]])
            parts.append((float(m1[0]) / 2.0, float(m1[1]) / 2.0, float(m2[0]), 1.0))
    low, high, decay, gain = zip(*parts, strict=True)
    return min(low), max(high), min(decay), max(gain)
