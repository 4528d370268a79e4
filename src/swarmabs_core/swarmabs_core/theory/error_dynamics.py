r"""How the errors of the abstract state decay under the robots' laws (theorems LQR_SI_sys and LQR_DI_sys).

Single integrators make :math:`\dot e = -K e`, double integrators :math:`\ddot e = -K_p e - K_d \dot e`. With the
Lyapunov functions of the paper, :math:`|e|^2/2` and :math:`\frac12 z^T M_1 z` with :math:`z = (e, \dot e)` and
:math:`M_1 = [[K_p, \epsilon I], [\epsilon I, I]]`, everything that the parent system needs to know are three numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, exp, inf, log, pi, sin, sqrt

Pair = tuple[float, float]


def epsilon_bound(kp: float, kd: float) -> float:
    """Return the corrected bound of epsilon (eq. DI_cond1 to DI_cond4) of one axis; it is positive for positive gains.

    M1 > 0 asks for epsilon^2 < kp; M2 < 0 for epsilon < kd and
    ``epsilon kp (kd - epsilon) > epsilon^2 kd^2/4``, which is ``epsilon < 4 kp kd/(4 kp + kd^2)``.

    Parameters
    ----------
    kp, kd : float
        Gains of the axis, 1/s^2 and 1/s.

    Returns
    -------
    float
        1/s.
    """
    return min(sqrt(kp), kd, 4.0 * kp * kd / (4.0 * kp + kd * kd))


def printed_epsilon_bound(kp: float, kd: float) -> float:
    """Return the bound of epsilon that the printed conditions leave; none does if it is not positive.

    eq. DI_cond2 prints epsilon/4 kd^2 for epsilon^2/4 kd^2, eq. DI_cond1 has kp and kd where both must be compared
    with epsilon alone. Parameters and result as of `epsilon_bound`.
    """
    trace = kd / (1.0 - kp) if kp < 1.0 else inf
    return min(sqrt(kp), trace, kd - kd * kd / (4.0 * kp))


@dataclass(frozen=True, slots=True)
class ErrorDynamics:
    """What the proofs use of a swarm's error dynamics, whose Lyapunov function is V_a.

    Parameters
    ----------
    decay : float
        a of ``V_a' <= -a e_tau^2``, V_a per (N m)^2 and s.
    torque : float
        b of ``|e_tau| <= b sqrt(2 V_a)``.
    inertia_rate : float
        d of ``|e_J'| <= d sqrt(2 V_a)``.
    """

    decay: float
    torque: float
    inertia_rate: float

    def with_other(self, other: ErrorDynamics) -> ErrorDynamics:
        """Return numbers that hold for the errors of both parts of a mixed swarm."""
        return ErrorDynamics(
            min(self.decay, other.decay), max(self.torque, other.torque), max(self.inertia_rate, other.inertia_rate)
        )


def first_order(k: Pair) -> ErrorDynamics:
    """Return the numbers of single integrators with gains `k` (1/s) and V_a = |e|^2/2."""
    return ErrorDynamics(k[0], 1.0, k[1])


def second_order(kp: Pair, kd: Pair, epsilon: float) -> ErrorDynamics:
    """Return the numbers of double integrators with V_a = z' M1 z/2.

    Parameters
    ----------
    kp, kd : tuple of float
        Gains, 1/s^2 and 1/s.
    epsilon : float
        1/s, below `epsilon_bound` of both axes.
    """
    square = epsilon * epsilon
    return ErrorDynamics(
        epsilon * kp[0] - square * kd[0] * kd[0] / (4.0 * (kd[0] - epsilon)),
        1.0 / sqrt(kp[0] - square),
        sqrt(kp[1] / (kp[1] - square)),
    )


def first_order_energy(error: Pair) -> float:
    """Return V_a = |e|^2/2 of an error (N m, kg m^2)."""
    return 0.5 * (error[0] * error[0] + error[1] * error[1])


def second_order_energy(kp: Pair, epsilon: float, error: Pair, rate: Pair) -> float:
    """Return V_a = z' M1 z/2 of an error (N m, kg m^2) and its rate; gains as of `second_order`."""
    return sum(0.5 * (k * e * e + 2.0 * epsilon * e * de + de * de) for k, e, de in zip(kp, error, rate, strict=True))


def deepest_swing(kp: float, kd: float, excess: float, rate: float) -> float:
    """Return the least value, at most 0, of the solution of ``x'' + kd x' + kp x = 0``.

    Parameters
    ----------
    kp, kd : float
        1/s^2 and 1/s, both positive.
    excess, rate : float
        x and x' at the start, in any unit and that per s.
    """
    if kd * kd < 4.0 * kp:
        return min(0.0, excess, *_oscillating_extrema(kp, kd, excess, rate))
    return min(0.0, excess, _creeping_extremum(kp, kd, excess, rate))


def _oscillating_extrema(kp: float, kd: float, excess: float, rate: float) -> tuple[float, float]:
    """Return the first two extrema; all later ones are smaller."""
    decay, frequency = kd / 2.0, sqrt(kp - kd * kd / 4.0)
    sine = (rate + decay * excess) / frequency  # x = exp(-decay t) (excess cos + sine sin)
    first = atan2(rate, (kp * excess + decay * rate) / frequency) % pi
    at_first = exp(-decay * first / frequency) * (excess * cos(first) + sine * sin(first))
    return at_first, -at_first * exp(-decay * pi / frequency)


def _creeping_extremum(kp: float, kd: float, excess: float, rate: float) -> float:
    """Return x where x' vanishes, or 0 if it does not; a double root is split by its millionth part."""
    root = max(sqrt(kd * kd / 4.0 - kp), 5e-7 * kd)
    fast = -kd / 2.0 - root
    slow = kp / fast  # which keeps its digits where both terms of its sum nearly cancel
    of_slow, of_fast = (rate - fast * excess) / (2.0 * root), (slow * excess - rate) / (2.0 * root)
    ratio = -of_fast * fast / (of_slow * slow) if of_slow else 0.0
    if ratio <= 1.0:
        return 0.0
    time = log(ratio) / (2.0 * root)
    return of_slow * exp(slow * time) + of_fast * exp(fast * time)
