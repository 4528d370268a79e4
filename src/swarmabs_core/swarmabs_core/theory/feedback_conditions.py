"""The theorems of a plane under state feedback: LQR_SI_sys, LQR_DI_sys and LQR_noHomo_sys."""

from __future__ import annotations

from math import cos, inf, sqrt
from typing import TYPE_CHECKING

from swarmabs_core.controllers.feedback import StateFeedback
from swarmabs_core.theory.attraction import balls, corrected_eta, printed_eta, radius_squared
from swarmabs_core.theory.level_set import (
    LevelSet,
    Loop,
    largest_torque,
    least_viscous,
    level_set,
    matrix_eigenvalues,
    potential,
    printed_inertia_rate,
)
from swarmabs_core.theory.report import Condition, Form, ParentCheck, finite
from swarmabs_core.theory.swarm_conditions import swarm_conditions

if TYPE_CHECKING:
    from swarmabs_core.theory.setting import Setting


def check_feedback(setting: Setting) -> ParentCheck | None:
    """Evaluate the theorem; None if the parent controller is no state feedback."""
    law = setting.law
    if not isinstance(law, StateFeedback):
        return None
    plane, manifold = setting.plane, setting.manifold
    loop = Loop(law.k1, law.k2, plane.inertia, setting.friction, manifold, setting.errors)
    region = level_set(loop, setting.angle_max)
    largest = manifold.inertia(manifold.torque_max)
    printed_square = radius_squared(setting.angle_max, printed_eta(plane.inertia, largest))
    corrected_square = radius_squared(setting.angle_max, corrected_eta(plane.inertia, largest))
    inertia_rate = printed_inertia_rate(loop, setting.gains.k[1], sqrt(printed_square))
    error = setting.initial_error
    square = plane.angle**2 + plane.angular_velocity**2 + error[0] ** 2 + error[1] ** 2
    if setting.has_double:
        rate = setting.initial_error_rate
        square += rate[0] ** 2 + rate[1] ** 2
    kinetic = 0.5 * (plane.inertia + setting.initial.inertia) * plane.angular_velocity**2
    weighted = region.weight * setting.error_energy if region.weight < inf else inf
    energy = law.k1 * potential(plane.angle) + kinetic + weighted
    cosine = cos(setting.angle_max)
    conditions = (
        Condition("k1", Form("k1 > 0", law.k1, 0.0), Form("k1 > 0", law.k1, 0.0), {"k1": law.k1}),
        Condition(
            "k2",
            Form("k2 > J'max/(2 cos th_max)", law.k2, inertia_rate / (2.0 * cosine)),
            Form(
                "cos(th_max) k2 + g6 > J'max/2",
                cosine * law.k2 + least_viscous(setting.friction),
                region.inertia_rate / 2.0,
            ),
            {
                "k2": law.k2,
                "angle_max": setting.angle_max,
                "viscous": least_viscous(setting.friction),
                "inertia_rate_printed": inertia_rate,
                "inertia_rate_corrected": region.inertia_rate,
                "tolerated_inertia_rate_printed": 2.0 * cosine * law.k2,
                "tolerated_inertia_rate_corrected": 2.0 * (cosine * law.k2 + least_viscous(setting.friction)),
            },
            "J'max printed by lemma J_dot_is_bounded, corrected as bound over the proven region",
        ),
        _lyapunov(law, region, inertia_rate, setting.angle_max),
        Condition(
            "disturbance",
            None,
            Form("no disturbance torque", abs(plane.disturbance.amplitude), 0.0, "<="),
            {"amplitude": plane.disturbance.amplitude},
            "state feedback has no integral part: a disturbance leaves an error",
        ),
        Condition(
            "torque limit",
            None,
            Form("largest |tau_sd| asked for in S <= torque_max", region.torque, manifold.torque_max, "<="),
            {"largest_torque": region.torque, "torque_max": manifold.torque_max},
            "the proof has the law without its limit",
        ),
        *swarm_conditions(setting),
        Condition(
            "initial state",
            Form("|z0|^2 <= th_max^2/(2 max{1, (J + Jmax)/2})", square, printed_square, "<="),
            Form("V(z0) <= k1 (th_max sin th_max + cos th_max - 1)", energy, region.level, "<="),
            {
                "angle": plane.angle,
                "angular_velocity": plane.angular_velocity,
                "torque_error": error[0],
                "inertia_error": error[1],
                "error_squared": square,
                "corrected_ball_squared": corrected_square,
                "weight": region.weight,
            },
            "S is the level set of the corrected V; another th_max gives another S",
        ),
    )
    attraction = balls(square, printed_square, corrected_square) | {
        "level": region.level,
        "initial_energy": finite(energy),
        "in_level_set": energy <= region.level,
        "weight": finite(region.weight),
        "largest_rate": region.rate,
        "largest_torque": region.torque,
        "largest_inertia_rate": finite(region.inertia_rate),
    }
    reached = largest_torque(loop, setting.angle_max, min(max(energy, 0.0), region.level))
    derivative = Condition(
        "negative derivative",
        Form(
            "V_p' negative definite: least eigenvalue of M's symmetric part > 0",
            matrix_eigenvalues(law.k1, law.k2, setting.angle_max, 0.0)[0],
            0.0,
        ),
        Form("V' <= 0, and 0 on no trajectory but the origin: 4 kappa a D > 1", region.coupling, 1.0),
        {},
        "V' does not depend on th, so the theorem of LaSalle is needed where the paper asks for a definite V_p'",
    )
    return ParentCheck(
        "LQR",
        conditions,
        derivative,
        min(reached, manifold.torque_max),
        0.0,
        region.level,
        energy,
        (min(plane.inertia / 2.0, region.level / setting.angle_max**2), region.weight * setting.error_growth),
        attraction,
    )


def _lyapunov(law: StateFeedback, region: LevelSet, inertia_rate: float, angle_max: float) -> Condition:
    """Return the condition that the derivative of the Lyapunov function is negative."""
    trace = cos(angle_max) * law.k2 - inertia_rate / 2.0
    return Condition(
        "Lyapunov function",
        Form("eigenvalues of M have positive real parts", min(trace, cos(angle_max) * law.k1), 0.0),
        Form("4 kappa a D > 1", region.coupling, 1.0),
        {
            "symmetric_part_eigenvalues": matrix_eigenvalues(law.k1, law.k2, angle_max, 0.0),
            "symmetric_part_eigenvalues_at_printed_rate": matrix_eigenvalues(law.k1, law.k2, angle_max, inertia_rate),
            "damping": region.damping,
            "weight": region.weight,
        },
        "M is not symmetric and its symmetric part is indefinite, so the printed V_p can grow; corrected: "
        "V = k1 (th sin th + cos th - 1) + (J + Js) w^2/2 + kappa V_a",
    )
