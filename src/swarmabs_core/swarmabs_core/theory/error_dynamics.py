r"""Decay of the errors of the abstract state under the robots' laws, and the theorems' conditions on the robots' gains.

For single integrators :math:`\dot e = -K e`, for double integrators :math:`\ddot e = -K_p e - K_d \dot e` (theorems
LQR_SI_sys and LQR_DI_sys). The Lyapunov functions V_a are those of the paper, :math:`|e|^2/2` and
:math:`\frac12 z^T M_1 z` with :math:`z = (e, \dot e)` and :math:`M_1 = [[K_p, \epsilon I], [\epsilon I, I]]`.
"""

from __future__ import annotations

from math import atan2, cos, exp, inf, log, pi, sin, sqrt
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.summation import added
from swarmabs_core.theory.report import Condition, Form

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.swarm_law import SwarmGains
    from swarmabs_core.theory.setting import Setting

Pair = tuple[float, float]

RESERVE = 0.5
"""Fraction of the manifold's smallest inertia that must remain."""


def epsilon_bound(kp: float, kd: float) -> float:
    """Return the corrected bound of epsilon (eq. DI_cond1 to DI_cond4) for one axis, 1/s; positive for positive gains.

    M1 > 0 requires epsilon^2 < kp; M2 < 0 requires epsilon < kd and
    ``epsilon kp (kd - epsilon) > epsilon^2 kd^2/4``, which is ``epsilon < 4 kp kd/(4 kp + kd^2)``. The gains are in
    1/s^2 and 1/s.
    """
    return min(sqrt(kp), kd, 4.0 * kp * kd / (4.0 * kp + kd * kd))


def printed_epsilon_bound(kp: float, kd: float) -> float:
    """Return the bound of epsilon by the printed conditions; if it is not positive, no epsilon satisfies them.

    eq. DI_cond2 prints epsilon/4 kd^2 instead of epsilon^2/4 kd^2; eq. DI_cond1 combines kp and kd, although each must
    be compared with epsilon alone.
    """
    trace = kd / (1.0 - kp) if kp < 1.0 else inf
    return min(sqrt(kp), trace, kd - kd * kd / (4.0 * kp))


def chosen_epsilon(gains: SwarmGains) -> float:
    """Return the epsilon used, half of its corrected bound over both axes, 1/s."""
    return min(epsilon_bound(kp, kd) for kp, kd in zip(gains.kp, gains.kd, strict=True)) / 2.0


class ErrorDynamics(NamedTuple):
    """Properties of a swarm's error dynamics, with Lyapunov function V_a, that the proofs use."""

    decay: float  # a of V_a' <= -a e_tau^2, V_a per (N m)^2 and s
    torque: float  # b of |e_tau| <= b sqrt(2 V_a)
    inertia_rate: float  # d of |e_J'| <= d sqrt(2 V_a)
    growth: float  # the largest g of V_a >= g |e_a|^2


def first_order(k: Pair) -> ErrorDynamics:
    """Return the properties of single integrators with gains `k` (1/s) and V_a = |e|^2/2."""
    return ErrorDynamics(k[0], 1.0, k[1], 0.5)


def second_order(kp: Pair, kd: Pair, epsilon: float) -> ErrorDynamics:
    """Return the properties of double integrators with V_a = z' M1 z/2; gains in 1/s^2 and 1/s.

    `epsilon` (1/s) is below `epsilon_bound` of both axes.
    """
    square = epsilon * epsilon
    return ErrorDynamics(
        epsilon * kp[0] - square * kd[0] * kd[0] / (4.0 * (kd[0] - epsilon)),
        1.0 / sqrt(kp[0] - square),
        sqrt(kp[1] / (kp[1] - square)),
        (min(kp) - epsilon**2) / 2.0,
    )


def swarm_errors(setting: Setting) -> ErrorDynamics:
    """Return the properties of a swarm; for a mixed one, those that hold for the errors of both parts."""
    gains, parts = setting.gains, []
    if setting.has_single:
        parts.append(first_order(gains.k))
    if setting.has_double:
        parts.append(second_order(gains.kp, gains.kd, chosen_epsilon(gains)))
    decay, torque, inertia_rate, growth = zip(*parts, strict=True)
    return ErrorDynamics(min(decay), max(torque), max(inertia_rate), min(growth))


def initial_energy(setting: Setting) -> float:
    """Return V_a at the start; for a mixed swarm, the sum of both parts' functions, each with the whole error."""
    gains, error, energy = setting.gains, setting.initial_error, 0.0
    if setting.has_single:
        energy += 0.5 * (error[0] * error[0] + error[1] * error[1])
    if setting.has_double:
        energy += second_order_energy(gains.kp, chosen_epsilon(gains), error, setting.initial_error_rate)
    return energy


def second_order_energy(kp: Pair, epsilon: float, error: Pair, rate: Pair) -> float:
    """Return V_a = z' M1 z/2 of an error (N m, kg m^2) and its rate; gains as in `second_order`."""
    return added(0.5 * (k * e * e + 2.0 * epsilon * e * de + de * de) for k, e, de in zip(kp, error, rate, strict=True))


def deepest_swing(kp: float, kd: float, excess: float, rate: float) -> float:
    """Return the smallest value, or 0 if that is less, of the solution of ``x'' + kd x' + kp x = 0``.

    `excess` and `rate` are x and x' at the start; the gains, 1/s^2 and 1/s, are positive.
    """
    if kd * kd < 4.0 * kp:
        return min(0.0, excess, *_underdamped_extrema(kp, kd, excess, rate))
    return min(0.0, excess, _overdamped_extremum(kp, kd, excess, rate))


def _underdamped_extrema(kp: float, kd: float, excess: float, rate: float) -> tuple[float, float]:
    """Return the first two extrema; all later ones are smaller."""
    decay, frequency = kd / 2.0, sqrt(kp - kd * kd / 4.0)
    sine = (rate + decay * excess) / frequency  # x = exp(-decay t) (excess cos + sine sin)
    first = atan2(rate, (kp * excess + decay * rate) / frequency) % pi
    at_first = exp(-decay * first / frequency) * (excess * cos(first) + sine * sin(first))
    return at_first, -at_first * exp(-decay * pi / frequency)


def _overdamped_extremum(kp: float, kd: float, excess: float, rate: float) -> float:
    """Return x where x' vanishes, or 0 if it does not; a double root is split by a millionth of its value."""
    root = max(sqrt(kd * kd / 4.0 - kp), 5e-7 * kd)
    fast = -kd / 2.0 - root
    slow = kp / fast  # the quotient avoids cancellation in the sum of both terms
    of_slow, of_fast = (rate - fast * excess) / (2.0 * root), (slow * excess - rate) / (2.0 * root)
    ratio = -of_fast * fast / (of_slow * slow) if of_slow else 0.0
    if ratio <= 1.0:
        return 0.0
    time = log(ratio) / (2.0 * root)
    return of_slow * exp(slow * time) + of_fast * exp(fast * time)


def gain_conditions(setting: Setting) -> Iterator[Condition]:
    """Yield the theorems' conditions on the swarm's gains: K, and epsilon of eq. DI_cond1 to DI_cond4."""
    gains = setting.gains
    if setting.has_single:
        form = Form("K > 0", min(gains.k), 0.0)
        yield Condition("K", form, form, {"k": gains.k})
    if setting.has_double:
        pairs = list(zip(gains.kp, gains.kd, strict=True))
        printed, corrected = min(printed_epsilon_bound(*p) for p in pairs), min(epsilon_bound(*p) for p in pairs)
        yield Condition(
            "epsilon",
            Form("an eps > 0 below min(sqrt kp, kd - kd^2/(4 kp))", printed, 0.0),
            Form("an eps > 0 below min(sqrt kp, kd, 4 kp kd/(4 kp + kd^2))", corrected, 0.0),
            {"kp": gains.kp, "kd": gains.kd},
            "eq. DI_cond2 prints eps/4 kd^2 instead of eps^2/4 kd^2; the corrected set is never empty",
        )


def inertia_swing(setting: Setting) -> Iterator[Condition]:
    """Yield the condition that the inertia of double integrators stays away from 0, where S3 vanishes.

    The excess x = J_s - J_sd obeys x'' + kd x' + kp x = 0. If kd < 2 sqrt(kp), it swings below 0 in proportion to its
    initial size, and J_s falls below the smallest inertia of the manifold.
    """
    if not setting.has_double:
        return
    offset, kp, kd = setting.manifold.offset, setting.gains.kp[1], setting.gains.kd[1]
    excess, rate = -setting.initial_error[1], -setting.initial_error_rate[1]
    swing, critical = deepest_swing(kp, kd, excess, rate), 2.0 * sqrt(kp)
    lowest = offset + swing if swing < min(excess, 0.0) else offset  # a start below J_sd is not a swing
    cure = (
        "Kd < 2 sqrt(Kp) with a large Js(0): near Js = 0, S3 also vanishes and the swarm is flung apart; "
        f"kd >= {critical:.4g} prevents this"
    )
    yield Condition(
        "inertia swing",
        None,
        Form("least Js of the error dynamics >= offset/2", lowest, RESERVE * offset, ">="),
        {
            "kp": kp,
            "kd": kd,
            "critical_kd": critical,
            "initial_inertia": setting.initial.inertia,
            "swing": swing,
            "offset": offset,
        },
        cure if kd < critical else "",
    )
