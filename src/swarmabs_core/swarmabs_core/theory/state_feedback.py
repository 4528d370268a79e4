r"""The theorems for a plane under state feedback, LQR_SI_sys, LQR_DI_sys and LQR_noHomo_sys, and a proven region.

With the error :math:`z = (\theta, \dot\theta, e_\tau, e_J)` the paper estimates the region of attraction by the ball
:math:`|z|^2 \le \theta_{max}^2 / (2 \eta)`, for which it prints two values of :math:`\eta`: one in the theorem, another
in its proof. The latter correctly bounds the coefficient of the kinetic energy, so it is the corrected one here; see
docs/how-to/sweep.md. The paper also uses the abstract state without g as its error; here
:math:`e_a(0) = a_d(0) - a(0)`.

Its :math:`V_p = \theta^2/2 + (J + J_s) \dot\theta^2/2` can grow along solutions: the symmetric part of its matrix M is
indefinite. With

.. math:: V = k_1 (\theta \sin\theta + \cos\theta - 1) + \tfrac12 (J + J_s) w^2 + \kappa V_a

the terms in :math:`\theta w` cancel, and

.. math:: \dot V \le -D w^2 + |w| |e_\tau| - \kappa a e_\tau^2, \qquad
          D = \cos(\theta_{max}) k_2 + \gamma - \tfrac12 \dot J_{max}

where :math:`\gamma` is the smallest slope :math:`f_f(w)/w`. If D > 0 and :math:`4 \kappa a D > 1`, this is negative
unless w and e vanish, and by LaSalle's principle the state tends to 0 from every level set
:math:`V \le c = k_1 (\theta_{max} \sin\theta_{max} + \cos\theta_{max} - 1)`. The rate :math:`\dot J_{max}` is that in
this set. A small :math:`\kappa` enlarges the set and with it :math:`\dot J_{max}`; the smallest :math:`\kappa` is used
that retains a tenth of the D of a swarm without errors, and :math:`4 \kappa a D \ge 2`.
"""

from __future__ import annotations

from math import cos, inf, sin, sqrt, tan
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.controllers import StateFeedback
from swarmabs_core.messages import PlaneState
from swarmabs_core.theory.error_dynamics import gain_conditions, initial_energy, swarm_errors
from swarmabs_core.theory.report import Condition, Form, ParentCheck

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.manifold import Manifold
    from swarmabs_core.plant import Friction
    from swarmabs_core.theory.error_dynamics import ErrorDynamics
    from swarmabs_core.theory.report import Number
    from swarmabs_core.theory.setting import Setting

ANGLE_MAX = 0.2
"""The paper's bound theta_max of the angle, rad."""
GRID = 2000


def printed_eta(inertia: float, largest_inertia: float) -> float:
    """Return eta = max{1, (J + J_sd,max)/2} of the theorem; the inertias are in kg m^2."""
    return max(1.0, 0.5 * (inertia + largest_inertia))


def corrected_eta(inertia: float, largest_inertia: float) -> float:
    """Return eta = max{1/2, (J + J_sd,max)/2} of the theorem's proof."""
    return max(0.5, 0.5 * (inertia + largest_inertia))


def radius_squared(angle_max: float, eta: float) -> float:
    """Return theta_max^2/(2 eta), the largest |z|^2 in the estimate; `angle_max` in rad."""
    return angle_max * angle_max / (2.0 * eta)


def balls(square: float, printed: float, corrected: float) -> dict[str, Number]:
    """Return whether an initial |z|^2 is in the printed and the corrected estimate, given by their largest |z|^2."""
    return {
        "initial_error_squared": square,
        "printed_radius_squared": printed,
        "in_printed_ball": square <= printed,
        "corrected_radius_squared": corrected,
        "in_corrected_ball": square <= corrected,
    }


class Estimate(NamedTuple):
    """The estimates for one setting, as functions of the plane's initial state, with the setting's initial swarm."""

    setting: Setting
    printed: float  # largest |z|^2 of the printed estimate
    corrected: float

    def error_squared(self, angle: float, angular_velocity: float) -> float:
        """Return |z|^2 of an initial state of the plane, in rad and rad/s, with this swarm.

        The desired abstract state starts, unfiltered, at the limited torque that the controller requests.
        """
        manifold, swarm = self.setting.manifold, self.setting.initial
        wanted = self.setting.requested(self.setting.law, PlaneState(0, 0, angle, angular_velocity))
        e_torque = wanted - swarm.torque
        e_inertia = manifold.inertia(wanted) - swarm.inertia
        return angle * angle + angular_velocity * angular_velocity + e_torque * e_torque + e_inertia * e_inertia


def estimate(setting: Setting) -> Estimate | None:
    """Return the estimates for a setting; None if its parent controller is not state feedback."""
    if not isinstance(setting.law, StateFeedback):
        return None
    manifold = setting.manifold
    inertias = (setting.plane.inertia, manifold.inertia(manifold.torque_max))
    return Estimate(
        setting,
        radius_squared(setting.angle_max, printed_eta(*inertias)),
        radius_squared(setting.angle_max, corrected_eta(*inertias)),
    )


def potential(angle: float) -> float:
    """Return ``th sin th + cos th - 1`` of an angle in rad, which increases with abs(th) up to pi/2."""
    return angle * sin(angle) + cos(angle) - 1.0


def least_viscous(friction: Friction) -> float:
    """Return a lower bound of f_f(w)/w, N m s/rad: g6, or less if g2 < g3, where the Stribeck term drives the plane."""
    return friction.g6 + min(0.0, friction.g1 * (friction.g2 - friction.g3))


class Loop(NamedTuple):
    """A plane under state feedback."""

    k1: float  # N m/rad
    k2: float  # N m s/rad
    inertia: float  # J of the plane, with sum m h^2 of the robots, kg m^2
    friction: Friction
    manifold: Manifold  # of the desired abstract state
    errors: ErrorDynamics  # how the swarm follows it
    weight: float = 0.0  # g H of masses above the axis that is not compensated, N m
    compensated: float = 0.0  # g H that is compensated, N m

    def potential(self, angle: float) -> float:
        """Return the part of V (N m) that depends on the angle (rad)."""
        return self.k1 * potential(angle) - self.weight * (1.0 - cos(angle))


class LevelSet(NamedTuple):
    """The set V <= level, and bounds within it."""

    level: float  # c, N m
    weight: float  # kappa; infinite if there is none
    rate: float  # largest |w|, rad/s
    torque: float  # largest torque that the controller requests, before it is limited, N m
    inertia_rate: float  # J'max, largest |J_s'|, kg m^2/s; infinite if it has no bound
    damping: float  # D, N m s/rad
    coupling: float  # 4 kappa a D, which must exceed 1


def level_set(loop: Loop, angle_max: float) -> LevelSet:
    """Return the level set that touches abs(th) = angle_max (rad), which must be below pi/2."""
    level = max(0.0, loop.potential(angle_max))
    torque = largest_torque(loop, angle_max, level)
    best = _with_weight(loop, angle_max, level, torque, inf)
    if best.damping <= 0.0:
        return best

    def suffices(weight: float) -> bool:  # the rate decreases with the weight, so D and the coupling increase
        region = _with_weight(loop, angle_max, level, torque, weight)
        return region.damping >= best.damping / 10.0 and region.coupling >= 2.0

    low = high = 1.0
    while not suffices(high):
        high *= 10.0
    while suffices(low):
        low /= 10.0
    while high > (1.0 + 1e-9) * low:
        middle = sqrt(low * high)
        low, high = (low, middle) if suffices(middle) else (middle, high)
    return _with_weight(loop, angle_max, level, torque, high)


def _with_weight(loop: Loop, angle_max: float, level: float, torque: float, weight: float) -> LevelSet:
    rate = sqrt(2.0 * level / loop.inertia)
    bounds = rate, min(torque, loop.manifold.torque_max), sqrt(2.0 * level / weight)
    inertia_rate = _inertia_rate(loop, angle_max, *bounds)
    damping = cos(angle_max) * loop.k2 + least_viscous(loop.friction) - inertia_rate / 2.0
    coupling = 4.0 * weight * loop.errors.decay * damping if weight < inf else -inf
    return LevelSet(level, weight, rate, torque, inertia_rate, damping, coupling)


def largest_torque(loop: Loop, angle_max: float, level: float) -> float:
    """Return the largest torque (N m) that is requested within V <= level (N m) and abs(th) <= angle_max (rad)."""
    angles = (angle_max * index / GRID for index in range(GRID + 1))
    left = ((angle, level - loop.potential(angle)) for angle in angles)
    return max(
        abs(loop.k1) * angle + abs(loop.compensated) * tan(angle) + abs(loop.k2) * sqrt(2.0 * rest / loop.inertia)
        for angle, rest in left
        if rest >= 0.0
    )


def _inertia_rate(loop: Loop, angle_max: float, rate: float, torque: float, error: float) -> float:
    """Bound abs(J_s'), where J_s' = J_sd' - e_J' and J_sd' = 2 A tau (k1 w + k2 w') (lemma J_dot_is_bounded).

    w' depends on J_s', so the inequality is solved for J_s'. The weight of masses above the axis adds to w', and its
    compensation to k1.
    """
    slope = 2.0 * loop.manifold.curvature * torque
    rest = 1.0 - slope * abs(loop.k2) * rate / loop.inertia
    if rest <= 0.0:
        return inf
    f = loop.friction
    opposing = torque + loop.errors.torque * error + f.g1 + f.g4 + f.g6 * rate
    opposing += abs(loop.weight + loop.compensated) * sin(angle_max)
    k1 = abs(loop.k1) + abs(loop.compensated) / cos(angle_max) ** 2
    asked = slope * (k1 * rate + abs(loop.k2) * opposing / loop.inertia)
    return (asked + loop.errors.inertia_rate * error) / rest


def printed_inertia_rate(loop: Loop, gain: float, radius: float) -> float:
    """Return J'max as printed in lemma J_dot_is_bounded, the largest value over the ball |z| <= radius.

    Its terms in e_J have the wrong sign and lack the inertia, and its denominator increases where it should decrease.
    `gain` is K of the inertia's error, 1/s.
    """
    manifold, f = loop.manifold, loop.friction
    slope = 2.0 * manifold.curvature * manifold.torque_max
    largest = manifold.inertia(manifold.torque_max)
    a1 = slope * loop.k1 / 2.0
    a2 = slope * (loop.k1 * (loop.inertia + largest) + loop.k2 * f.g6) - gain
    a3 = slope * loop.k2 * (manifold.torque_max + f.g1)
    b1, b2 = slope * loop.k2, loop.inertia + manifold.offset
    norms = [radius * index / GRID for index in range(GRID + 1)]
    values = [(a1 * z * z + a2 * z + a3) / (b1 * z + b2) if b1 * z + b2 > 0 else inf for z in norms]
    return max(0.0, *values)


def matrix_eigenvalues(k1: float, k2: float, angle_max: float, inertia_rate: float) -> tuple[float, float]:
    """Return the eigenvalues of the symmetric part of the matrix M of app. ProofLQR_SI, ascending.

    The gains are in N m/rad and N m s/rad, theta_max in rad, J'max in kg m^2/s.
    """
    corner = cos(angle_max) * k2 - inertia_rate / 2.0
    side = (cos(angle_max) * k1 - 1.0) / 2.0
    root = sqrt(corner * corner / 4.0 + side * side)
    return corner / 2.0 - root, corner / 2.0 + root


def _against_weight(setting: Setting, k1: float) -> Iterator[Condition]:
    """Yield the condition that the gain of the angle outweighs masses above the axis for all angles up to theta_max."""
    if setting.raised:
        angle = setting.angle_max
        yield Condition(
            "k1, heights",
            None,
            Form("k1 th_max cot th_max > g H that is not compensated", k1 * angle / tan(angle), setting.weight),
            {
                "k1": k1,
                "moment": setting.moment,
                "weight": setting.plane.gravity * setting.moment,
                "compensated": setting.compensated_weight,
            },
            "the weight of masses above the axis tips the plane over, by g H sin th",
        )


def undisturbed(setting: Setting, otherwise: str) -> Condition:
    """Return the condition that no disturbance acts, with what happens otherwise."""
    amplitude = setting.plane.disturbance.amplitude
    form = Form("no disturbance torque", abs(amplitude), 0.0, "<=")
    return Condition("disturbance", None, form, {"amplitude": amplitude}, otherwise)


def check_feedback(setting: Setting) -> ParentCheck | None:
    """Evaluate the theorem; return None if the parent controller is not state feedback."""
    law, ball = setting.law, estimate(setting)
    if not isinstance(law, StateFeedback) or ball is None:
        return None
    plane, manifold, angle_max = setting.plane, setting.manifold, setting.angle_max
    weights = setting.weight, setting.compensated_weight
    loop = Loop(law.k1, law.k2, setting.body_inertia, plane.friction, manifold, swarm_errors(setting), *weights)
    region = level_set(loop, angle_max)
    inertia_rate = printed_inertia_rate(loop, setting.gains.k[1], sqrt(ball.printed))
    error = setting.initial_error
    square = ball.error_squared(plane.angle, plane.angular_velocity)
    if setting.has_double:
        rate = setting.initial_error_rate
        square += rate[0] ** 2 + rate[1] ** 2
    kinetic = 0.5 * (setting.body_inertia + setting.initial.inertia) * plane.angular_velocity**2
    weighted = region.weight * initial_energy(setting) if region.weight < inf else inf
    energy = loop.potential(plane.angle) + kinetic + weighted
    positive = Form("k1 > 0", law.k1, 0.0)
    cosine, viscous = cos(angle_max), least_viscous(plane.friction)
    eigenvalues = matrix_eigenvalues(law.k1, law.k2, angle_max, 0.0)
    conditions = (
        Condition("k1", positive, positive, {"k1": law.k1}),
        *_against_weight(setting, law.k1),
        Condition(
            "k2",
            Form("k2 > J'max/(2 cos th_max)", law.k2, inertia_rate / (2.0 * cosine)),
            Form("cos(th_max) k2 + g6 > J'max/2", cosine * law.k2 + viscous, region.inertia_rate / 2.0),
            {
                "k2": law.k2,
                "angle_max": angle_max,
                "viscous": viscous,
                "inertia_rate_printed": inertia_rate,
                "inertia_rate_corrected": region.inertia_rate,
                "tolerated_inertia_rate_printed": 2.0 * cosine * law.k2,
                "tolerated_inertia_rate_corrected": 2.0 * (cosine * law.k2 + viscous),
            },
            "printed: J'max of lemma J_dot_is_bounded; corrected: bound over the proven region",
        ),
        Condition(
            "Lyapunov function",
            Form(
                "eigenvalues of M have positive real parts",
                min(cosine * law.k2 - inertia_rate / 2.0, cosine * law.k1),  # trace and determinant of M
                0.0,
            ),
            Form("4 kappa a D > 1", region.coupling, 1.0),
            {
                "symmetric_part_eigenvalues": eigenvalues,
                "symmetric_part_eigenvalues_at_printed_rate": matrix_eigenvalues(
                    law.k1, law.k2, angle_max, inertia_rate
                ),
                "damping": region.damping,
                "weight": region.weight,
            },
            "M is not symmetric and its symmetric part is indefinite, so the printed V_p can grow; corrected: "
            "V = k1 (th sin th + cos th - 1) + (J + Js) w^2/2 + kappa V_a",
        ),
        undisturbed(setting, "state feedback has no integral part: a disturbance leaves an error"),
        Condition(
            "torque limit",
            None,
            Form("largest |tau_sd| requested in S <= torque_max", region.torque, manifold.torque_max, "<="),
            {"largest_torque": region.torque, "torque_max": manifold.torque_max},
            "the proof does not consider the torque limit",
        ),
        *gain_conditions(setting),
        Condition(
            "initial state",
            Form("|z0|^2 <= th_max^2/(2 max{1, (J + Jmax)/2})", square, ball.printed, "<="),
            Form("V(z0) <= k1 (th_max sin th_max + cos th_max - 1)", energy, region.level, "<="),
            {
                "angle": plane.angle,
                "angular_velocity": plane.angular_velocity,
                "torque_error": error[0],
                "inertia_error": error[1],
                "error_squared": square,
                "corrected_ball_squared": ball.corrected,
                "weight": region.weight,
            },
            "S is the level set of the corrected V and depends on th_max",
        ),
    )
    reached = largest_torque(loop, angle_max, min(max(energy, 0.0), region.level))
    return ParentCheck(
        "LQR",
        conditions,
        derivative=Condition(
            "negative derivative",
            Form("V_p' negative definite: least eigenvalue of M's symmetric part > 0", eigenvalues[0], 0.0),
            Form("V' <= 0, and 0 on no trajectory but the origin: 4 kappa a D > 1", region.coupling, 1.0),
            {},
            "V' does not depend on th, so LaSalle's theorem is needed where the paper requires a definite V_p'",
        ),
        torque=min(reached, manifold.torque_max),
        largest_angle=0.0,
        level=region.level,
        energy=energy,
        growths=(min(setting.body_inertia / 2.0, region.level / angle_max**2), region.weight * loop.errors.growth),
        attraction=balls(square, ball.printed, ball.corrected)
        | {
            "level": region.level,
            "initial_energy": energy,
            "in_level_set": energy <= region.level,
            "weight": region.weight,
            "largest_rate": region.rate,
            "largest_torque": region.torque,
            "largest_inertia_rate": region.inertia_rate,
        },
    )
