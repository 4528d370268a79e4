r"""The abstract state of a swarm and its auxiliary state (eq. abstractState, eq. pinv).

.. math::

    \tau_s = g \sum m_i p_i \qquad J_s = \sum m_i p_i^2

    S_0 = \sum m_i^2 \quad S_1 = \sum m_i^2 p_i \quad S_2 = \sum m_i^2 p_i^2 \quad S_3 = S_0 S_2 - S_1^2

    D_k = \sum_{DI} m_i (c_i + k_{sd}) p_i^k \qquad Q = \sum m_i v_i^2

Every sum is correctly rounded (`exact_sum`), so it does not depend on the order in which states arrive. All functions
take robots as tuples or, with ``sums=column_sums``, as columns of arrays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from swarmabs_core.messages import AbstractState, AgentState, AuxiliaryState, Kind, StandingState, Status
from swarmabs_core.summation import Columns, Sums, determinant, each_sum, exact_sum, robot_sums

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from swarmabs_core.messages import AnyRobotState


class Weight(NamedTuple):
    """A robot as a load on the plane: mass (kg), position (m), velocity (m/s)."""

    mass: float
    position: float
    velocity: float


class Abstraction(NamedTuple):
    """Torque (N m) and inertia (kg m^2) of all robots on the plane, their rates, and Q (kg m^2/s^2)."""

    torque: float
    inertia: float
    torque_rate: float
    inertia_rate: float
    q: float


class SecondMoments(NamedTuple):
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


def abstraction(robots: Iterable[Weight] | Columns, gravity: float, sums: Sums = robot_sums) -> Abstraction:
    """Sum over all robots whose weight is on the plane, moving or not (eq. abstractState); gravity is in m/s^2."""
    moment, inertia, momentum, half_inertia_rate, q = sums(robots, _weight_terms, each_sum)
    return Abstraction(gravity * moment, inertia, gravity * momentum, 2.0 * half_inertia_rate, q)


def _weight_terms(m: float = 0.0, p: float = 0.0, v: float = 0.0) -> tuple[float, ...]:
    mp, mv = m * p, m * v
    return mp, mp * p, mv, mp * v, mv * v


def second_moments(robots: Iterable[tuple[float, float]] | Columns, sums: Sums = robot_sums) -> SecondMoments:
    """Return S0 to S3 of the robots that follow the law, each given by mass (kg) and position (m) (eq. pinv).

    S3 is computed from the exact sums of the rounded terms and rounded once; it is never negative. Its error is that of
    the terms, at most 3 * 2**-53 S0 S2: some 1e-8 of S3 at the least spread. Without robots, all sums are zero.
    """
    return SecondMoments(*sums(robots, _moment_terms, determinant))


def _moment_terms(m: float = 0.0, p: float = 0.0) -> tuple[float, ...]:
    mm = m * m
    mmp = mm * p
    return mm, mmp, mmp * p


def damping_sums(
    robots: Iterable[tuple[float, float, float]] | Columns, ksd: float, sums: Sums = robot_sums
) -> DampingSums:
    """Return D0 to D2 of the double integrators that follow the law (in eq. nodeControlLaw_double).

    Each is given by mass (kg), position (m) and damping (N s/m), to which the law adds `ksd` (N s/m).
    """

    def terms(m: float = 0.0, p: float = 0.0, c: float = 0.0) -> tuple[float, ...]:
        mc = m * (c + ksd)
        mcp = mc * p
        return mc, mcp, mcp * p

    return DampingSums(*sums(robots, terms, each_sum))


def observed(
    stamp: int, step: int, weights: Sequence[Weight], followers: Sequence[AgentState], gravity: float, ksd: float
) -> tuple[AbstractState, AuxiliaryState]:
    """Return the messages that an observer publishes in a step.

    Parameters
    ----------
    stamp, step : int
        Time stamp (ns) and step of both messages.
    weights, followers : sequence of Weight, sequence of AgentState
        All robots whose weight is on the plane, and the subset that follows the law.
    gravity : float
        Acceleration of gravity, m/s^2.
    ksd : float
        Damping that the law of double integrators adds, N s/m.
    """
    moved = [(s.mass, s.position) for s in followers]
    damped = [(s.mass, s.position, s.damping) for s in followers if s.kind == Kind.DOUBLE_INTEGRATOR]
    return summed(stamp, step, len(weights), (weights, moved, damped), (gravity, ksd))


def divided_load(stamp: int, step: int, robots: Iterable[AnyRobotState], gravity: float) -> StandingState:
    """Return how torque and inertia divide between robots that stand and those that follow the law; gravity in m/s^2.

    The robots are all whose weight is on the plane. Those that do not follow the law are assumed at rest.
    """
    parts: tuple[list[Weight], list[Weight]] = [], []
    for state in robots:
        if not isinstance(state, AgentState):
            continue
        parts[state.status == Status.ACTIVE].append(Weight(state.mass, state.position, state.velocity))
    still, moving = (abstraction(part, gravity) for part in parts)
    s0, s1, s2, _ = second_moments([(weight.mass, weight.position) for weight in parts[1]])
    masses = [exact_sum(weight.mass for weight in part) for part in parts]
    return StandingState(
        stamp,
        step,
        0,
        len(parts[0]),
        len(parts[1]),
        (still.torque, still.inertia),
        (masses[0],),
        (moving.torque, moving.inertia),
        (moving.torque_rate, moving.inertia_rate),
        (0.0, 2.0 * moving.q),
        (gravity * gravity * s0, 2.0 * gravity * s1, 4.0 * s2),
        float(len(parts[1])),
        (masses[1],),
    )


def summed(
    stamp: int,
    step: int,
    count: int,
    robots: tuple[Any, Any, Any],
    constants: tuple[float, float],
    sums: Sums = robot_sums,
) -> tuple[AbstractState, AuxiliaryState]:
    """Return what `observed` does for `robots` as `sums` takes them.

    The constants are gravity (m/s^2) and `ksd` (N s/m). The robots are the `count` whose weight is on the plane, as for
    `abstraction`; those that follow the law, as for `second_moments`; and the double integrators among these, as for
    `damping_sums`.
    """
    (weights, followers, damped), (gravity, ksd) = robots, constants
    *abstract, q = abstraction(weights, gravity, sums)
    moments = second_moments(followers, sums)
    return (
        AbstractState(stamp, step, count, *abstract),
        AuxiliaryState(stamp, step, *moments, *damping_sums(damped, ksd, sums), q),
    )


LEAST_SPREAD = 1e-4
"""Spread of the robots, in units of the plane's length, below which their inertia is no longer fully controlled."""
_LEAST = 1e-9


def damped(value: float, edge: float) -> float:
    """Return what replaces a divisor below an edge, in its unit: it grows without bound as the divisor vanishes."""
    return edge * edge / max(value, _LEAST * edge)


def least_s3(s0: float, length: float) -> float:
    """Return S3 (kg^4 m^2) at the least spread, for S0 (kg^2) and the length of the plane (m)."""
    return LEAST_SPREAD * LEAST_SPREAD * s0 * s0 * length * length


def is_degenerate(s0: float, s3: float, length: float) -> bool:
    """Return whether S3 is too small to divide by: all robots are nearly at one point of a plane of this length (m)."""
    return not s3 > least_s3(s0, length)


def conditioned(sums: AuxiliaryState, length: float) -> AuxiliaryState:
    """Return sums with which the laws can compute: the given ones, unless the robots are nearly at one point.

    There, S2 grows, and S3 with it, so that the laws still command the torque exactly and the inertia less and less:
    by the factor S3/S3' of the new S3', which vanishes at one point. S0 must be positive; the length is in m.
    """
    s0, s1, s3 = sums.s0, sums.s1, sums.s3
    if not is_degenerate(s0, s3, length):
        return sums
    edge = least_s3(s0, length)
    larger = damped(s3, edge)
    return sums._replace(s2=(larger + s1 * s1) / s0, s3=larger)
