r"""A region of attraction of a plane under state feedback that is proven (theorems LQR_SI_sys and its likes).

The paper's :math:`V_p = \theta^2/2 + (J + J_s) \dot\theta^2/2` can grow along solutions: the symmetric part of its
matrix M is indefinite. With

.. math:: V = k_1 (\theta \sin\theta + \cos\theta - 1) + \tfrac12 (J + J_s) w^2 + \kappa V_a

the terms in :math:`\theta w` cancel, and

.. math:: \dot V \le -D w^2 + |w| |e_\tau| - \kappa a e_\tau^2, \qquad
          D = \cos(\theta_{max}) k_2 + \gamma - \tfrac12 \dot J_{max}

where :math:`\gamma` is the least slope :math:`f_f(w)/w`. That is negative unless w and e vanish if D > 0 and
:math:`4 \kappa a D > 1`, and by LaSalle's principle the state tends to 0 from every level set
:math:`V \le c = k_1 (\theta_{max} \sin\theta_{max} + \cos\theta_{max} - 1)`. The rate :math:`\dot J_{max}` is that of
this set. A small :math:`\kappa` makes the set large and :math:`\dot J_{max}` with it; the one taken is the least that
leaves a tenth of the D that there is without errors of the swarm, and :math:`4 \kappa a D \ge 2`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, inf, sin, sqrt
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swarmabs_core.friction import Friction
    from swarmabs_core.manifold import Manifold
    from swarmabs_core.theory.error_dynamics import ErrorDynamics

GRID = 2000


def potential(angle: float) -> float:
    """Return ``th sin th + cos th - 1`` of an angle in rad; it grows with abs(th) up to pi/2."""
    return angle * sin(angle) + cos(angle) - 1.0


def least_viscous(friction: Friction) -> float:
    """Return a lower bound of f_f(w)/w, N m s/rad: g6, less if g2 < g3 makes the Stribeck term drive."""
    return friction.g6 + min(0.0, friction.g1 * (friction.g2 - friction.g3))


@dataclass(frozen=True, slots=True)
class Loop:
    """A plane under state feedback.

    Parameters
    ----------
    k1, k2 : float
        N m/rad, N m s/rad.
    inertia : float
        J of the plane alone, kg m^2.
    friction : Friction
        Of its bearing.
    manifold : Manifold
        Of the desired abstract state.
    errors : ErrorDynamics
        How the swarm follows it.
    """

    k1: float
    k2: float
    inertia: float
    friction: Friction
    manifold: Manifold
    errors: ErrorDynamics


@dataclass(frozen=True, slots=True)
class LevelSet:
    """The set V <= level and bounds that hold within it.

    Parameters
    ----------
    level : float
        c, N m.
    weight : float
        kappa; infinite if there is none.
    rate : float
        Largest abs(w), rad/s.
    torque : float
        Largest torque that the controller asks for, before it is limited, N m.
    inertia_rate : float
        J'max, largest abs(J_s'), kg m^2/s; infinite if it has no bound.
    damping : float
        D, N m s/rad.
    coupling : float
        4 kappa a D, which must exceed 1.
    """

    level: float
    weight: float
    rate: float
    torque: float
    inertia_rate: float
    damping: float
    coupling: float


def level_set(loop: Loop, angle_max: float) -> LevelSet:
    """Return the level set that touches abs(th) = angle_max.

    Parameters
    ----------
    loop : Loop
        The system.
    angle_max : float
        theta_max, rad, below pi/2.
    """
    level = max(0.0, loop.k1 * potential(angle_max))
    best = _with_weight(loop, angle_max, level, inf)
    if best.damping <= 0.0:
        return best

    def suffices(weight: float) -> bool:  # the rate falls with the weight, so D and the coupling grow
        found = _with_weight(loop, angle_max, level, weight)
        return found.damping >= best.damping / 10.0 and found.coupling >= 2.0

    low = high = 1.0
    while not suffices(high):
        high *= 10.0
    while suffices(low):
        low /= 10.0
    while high > (1.0 + 1e-9) * low:
        middle = sqrt(low * high)
        low, high = (low, middle) if suffices(middle) else (middle, high)
    return _with_weight(loop, angle_max, level, high)


def _with_weight(loop: Loop, angle_max: float, level: float, weight: float) -> LevelSet:
    rate = sqrt(2.0 * level / loop.inertia)
    torque = largest_torque(loop, angle_max, level)
    inertia_rate = _inertia_rate(loop, rate, min(torque, loop.manifold.torque_max), sqrt(2.0 * level / weight))
    damping = cos(angle_max) * loop.k2 + least_viscous(loop.friction) - inertia_rate / 2.0
    coupling = 4.0 * weight * loop.errors.decay * damping if weight < inf else -inf
    return LevelSet(level, weight, rate, torque, inertia_rate, damping, coupling)


def largest_torque(loop: Loop, angle_max: float, level: float) -> float:
    """Return the largest k1 th + abs(k2 w) (N m) within V <= level and abs(th) <= angle_max.

    Parameters
    ----------
    loop : Loop
        The system.
    angle_max, level : float
        rad, N m.
    """
    angles = (angle_max * index / GRID for index in range(GRID + 1))
    left = ((angle, level - loop.k1 * potential(angle)) for angle in angles)
    return max(
        abs(loop.k1) * angle + abs(loop.k2) * sqrt(2.0 * rest / loop.inertia) for angle, rest in left if rest >= 0.0
    )


def _inertia_rate(loop: Loop, rate: float, torque: float, error: float) -> float:
    """Bound abs(J_s'), where J_s' = J_sd' - e_J' and J_sd' = 2 A tau (k1 w + k2 w') (lemma J_dot_is_bounded).

    w' itself contains J_s', for which the equation is solved.
    """
    slope = 2.0 * loop.manifold.curvature * torque
    rest = 1.0 - slope * abs(loop.k2) * rate / loop.inertia
    if rest <= 0.0:
        return inf
    f = loop.friction
    opposing = torque + loop.errors.torque * error + f.g1 + f.g4 + f.g6 * rate
    asked = slope * (abs(loop.k1) * rate + abs(loop.k2) * opposing / loop.inertia)
    return (asked + loop.errors.inertia_rate * error) / rest


def printed_inertia_rate(loop: Loop, gain: float, radius: float) -> float:
    """Return J'max as lemma J_dot_is_bounded prints it, largest over the ball norm(z) <= radius.

    Its terms in e_J have the wrong sign and lack the inertia, and its denominator grows where it should shrink.

    Parameters
    ----------
    loop : Loop
        The system.
    gain : float
        K of the inertia's error, 1/s.
    radius : float
        Radius of the ball.
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

    Parameters
    ----------
    k1, k2 : float
        N m/rad, N m s/rad.
    angle_max, inertia_rate : float
        theta_max in rad and J'max in kg m^2/s.
    """
    corner = cos(angle_max) * k2 - inertia_rate / 2.0
    side = (cos(angle_max) * k1 - 1.0) / 2.0
    root = sqrt(corner * corner / 4.0 + side * side)
    return corner / 2.0 - root, corner / 2.0 + root
