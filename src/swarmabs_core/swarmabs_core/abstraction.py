r"""The abstract state of a swarm and its auxiliary state (eq. abstractState, eq. pinv).

.. math::

    \tau_s = g \sum m_i p_i \qquad J_s = \sum m_i p_i^2

    S_0 = \sum m_i^2 \quad S_1 = \sum m_i^2 p_i \quad S_2 = \sum m_i^2 p_i^2 \quad S_3 = S_0 S_2 - S_1^2

    D_k = \sum_{DI} m_i (c_i + k_{sd}) p_i^k \qquad Q = \sum m_i v_i^2

Every sum is correctly rounded (`exact_sum`), so it does not depend on the order in which robots were heard.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.summation import exact_sum

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


class Weight(NamedTuple):
    """A robot as the plane feels it: mass (kg), position (m), velocity (m/s)."""

    mass: float
    position: float
    velocity: float


class Abstraction(NamedTuple):
    """Torque (N m), inertia (kg m^2), their rates, and Q (kg m^2/s^2), of all robots on the plane."""

    torque: float
    inertia: float
    torque_rate: float
    inertia_rate: float
    q: float


class SpreadSums(NamedTuple):
    """S0 (kg^2), S1 (kg^2 m), S2 (kg^2 m^2), S3 (kg^4 m^2) over the robots that follow the law."""

    s0: float
    s1: float
    s2: float
    s3: float


class DampingSums(NamedTuple):
    """D0 (kg N s/m), D1 (kg N s), D2 (kg N s m) over the double integrators that follow the law."""

    d0: float
    d1: float
    d2: float


def abstraction(robots: Sequence[Weight], gravity: float) -> Abstraction:
    """Sum over all robots whose weight is on the plane, moving or not (eq. abstractState).

    Parameters
    ----------
    robots : sequence of Weight
        Robots on the plane.
    gravity : float
        m/s^2.
    """
    return Abstraction(
        gravity * exact_sum([m * p for m, p, _ in robots]),
        exact_sum([m * p * p for m, p, _ in robots]),
        gravity * exact_sum([m * v for m, _, v in robots]),
        2.0 * exact_sum([m * p * v for m, p, v in robots]),
        exact_sum([m * v * v for m, _, v in robots]),
    )


def spread_sums(robots: Iterable[tuple[float, float]]) -> SpreadSums:
    """Return S0..S3 of the robots that follow the law (eq. pinv).

    S3 is summed around the centre S1/S0, which keeps its digits when the robots are close together; it is
    never negative. No robots give zeros.

    Parameters
    ----------
    robots : iterable of tuple
        Mass (kg) and position (m) of each.
    """
    pairs = [(m * m, p) for m, p in robots]
    s0 = exact_sum([mm for mm, _ in pairs])
    s1 = exact_sum([mm * p for mm, p in pairs])
    centre = s1 / s0 if s0 else 0.0
    return SpreadSums(
        s0,
        s1,
        exact_sum([mm * p * p for mm, p in pairs]),
        s0 * exact_sum([mm * (p - centre) * (p - centre) for mm, p in pairs]),
    )


def damping_sums(robots: Iterable[tuple[float, float, float]], ksd: float) -> DampingSums:
    """Return D0..D2 of the double integrators that follow the law (in eq. nodeControlLaw_double).

    Parameters
    ----------
    robots : iterable of tuple
        Mass (kg), position (m) and damping (N s/m) of each.
    ksd : float
        Damping that the law adds, N s/m.
    """
    terms = [(m * (c + ksd), p) for m, p, c in robots]
    return DampingSums(
        exact_sum([mc for mc, _ in terms]),
        exact_sum([mc * p for mc, p in terms]),
        exact_sum([mc * p * p for mc, p in terms]),
    )


def is_degenerate(s0: float, s3: float, length: float) -> bool:
    """Tell whether S3 is too small to divide by: all stand at one point of a plane of this length (m)."""
    return not s3 > 1e-12 * s0 * s0 * length * length
