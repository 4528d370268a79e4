r"""Control laws of the robots (eq. nodeControlLaw, nodeControlLaw_double).

A robot knows only its own state and the broadcasts.

With :math:`e = a_d - a` and :math:`r_i` the i-th row of the pseudo-inverse of the abstraction's Jacobian

.. math:: r_i = \left[\frac{m_i (S_2 - p_i S_1)}{g S_3},\ \frac{m_i (p_i S_0 - S_1)}{2 S_3}\right]

a single integrator commands the velocity :math:`v_i = r_i (K e + \overline{\dot a_d})` and a double
integrator the force

.. math::

    u_i = m_i r_i (K_p e + (K_d - C_a) \dot e - [0, 2Q] + \ddot a_d)
        + (c_i + k_{sd}) r_i \dot a_d - k_{sd} v_i

In the paper, the pseudo-inverse lacks the 1/g, C_a lacks the division by S3, and :math:`\dot\Phi \dot p_i` replaces the
sum over the swarm, which is [0, 2Q]; this module computes the corrected forms.

Installed packages can provide other laws. One law is selected for the whole swarm. Each robot binds it to its own
constants on creation; from then on the law is a function of the robot's state and the broadcasts of one step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from swarmabs_core.declaration import setting
from swarmabs_core.messages import AbstractState, AuxiliaryState, DesiredAbstractState, Kind
from swarmabs_core.parameters import Settings
from swarmabs_core.registry import Part, Registry

Pair = tuple[float, float]
Command: TypeAlias = Callable[[float, float, AbstractState, AuxiliaryState, DesiredAbstractState], float]
"""Position (m), velocity (m/s) and the three broadcasts in, the command (m/s or N, by the robot's kind) out."""


def pinv_row(mass: float, position: float, sums: AuxiliaryState, gravity: float) -> Pair:
    """Return a robot's row of the pseudo-inverse (eq. pinv, with the missing 1/g); S3 must not vanish.

    Mass in kg, position in m and gravity in m/s^2 give velocity per torque rate, m/(N m), and per inertia rate,
    m/(kg m^2).
    """
    return (
        mass * (sums.s2 - position * sums.s1) / (gravity * sums.s3),
        mass * (position * sums.s0 - sums.s1) / (2.0 * sums.s3),
    )


def damping_matrix(sums: AuxiliaryState, gravity: float) -> tuple[float, float, float, float]:
    """Return C_a, the effect of damping on the rate of the abstract state (in eq. nodeControlLaw_double, corrected).

    It is Phi diag((c_i + k_sd)/m_i) Phi+ over the double integrators, row by row: 1/s on the diagonal, (N m)/(kg m^2 s)
    above and kg m^2/(N m s) below it. Gravity is in m/s^2; S3 must not vanish.
    """
    s0, s1, s2, s3 = sums.s0, sums.s1, sums.s2, sums.s3
    d0, d1, d2 = sums.d0, sums.d1, sums.d2
    return (
        (s2 * d0 - s1 * d1) / s3,
        gravity * (s0 * d1 - s1 * d0) / (2.0 * s3),
        2.0 * (s2 * d1 - s1 * d2) / (gravity * s3),
        (s0 * d2 - s1 * d1) / s3,
    )


@dataclass(frozen=True, slots=True)
class SwarmGains:
    """Gains of the robots' control laws; pairs are for torque and inertia."""

    k: Pair = setting((10.0, 10.0), "K of single integrators", unit="1/s", above=0.0, length=2)
    kp: Pair = setting((10.0, 10.0), "Kp of double integrators", unit="1/s^2", above=0.0, length=2)
    kd: Pair = setting((5.0, 5.0), "Kd of double integrators", unit="1/s", above=0.0, length=2)
    ksd: float = setting(1.0, "damping k_sd added to double integrators", unit="N s/m", minimum=0.0)


def single_integrator_command(
    mass: float,
    position: float,
    gains: SwarmGains,
    gravity: float,
    abstract: AbstractState,
    sums: AuxiliaryState,
    desired: DesiredAbstractState,
) -> float:
    """Return the velocity command (m/s) of a single integrator (eq. nodeControlLaw); S3 must not vanish.

    Mass (kg) and position (m) are those of the robot, gravity is in m/s^2; the broadcasts are those of one step. Only
    `k` of the gains is used.
    """
    r0, r1 = pinv_row(mass, position, sums, gravity)
    k0, k1 = gains.k
    return r0 * (k0 * (desired.torque - abstract.torque) + desired.mean_torque_rate) + r1 * (
        k1 * (desired.inertia - abstract.inertia) + desired.mean_inertia_rate
    )


def double_integrator_command(
    mass: float,
    damping: float,
    position: float,
    velocity: float,
    gains: SwarmGains,
    gravity: float,
    abstract: AbstractState,
    sums: AuxiliaryState,
    desired: DesiredAbstractState,
) -> float:
    """Return the force command (N) of a double integrator (eq. nodeControlLaw_double, corrected); S3 must not vanish.

    Parameters
    ----------
    mass, damping, position, velocity : float
        Of the robot, in kg, N s/m, m and m/s.
    gains : SwarmGains
        All except `k` are used.
    gravity : float
        Acceleration of gravity, m/s^2.
    abstract, sums, desired : AbstractState, AuxiliaryState, DesiredAbstractState
        The broadcasts of one step.
    """
    r0, r1 = pinv_row(mass, position, sums, gravity)
    c00, c01, c10, c11 = damping_matrix(sums, gravity)
    e0 = desired.torque - abstract.torque
    e1 = desired.inertia - abstract.inertia
    de0 = desired.torque_rate - abstract.torque_rate
    de1 = desired.inertia_rate - abstract.inertia_rate
    y0 = gains.kp[0] * e0 + (gains.kd[0] - c00) * de0 - c01 * de1 + desired.torque_acceleration
    y1 = gains.kp[1] * e1 - c10 * de0 + (gains.kd[1] - c11) * de1 - 2.0 * sums.q + desired.inertia_acceleration
    feed_forward = r0 * desired.torque_rate + r1 * desired.inertia_rate
    return mass * (r0 * y0 + r1 * y1) + (damping + gains.ksd) * feed_forward - gains.ksd * velocity


@dataclass(frozen=True, slots=True)
class Robot:
    """What a law may know about its robot, in addition to position and velocity."""

    kind: Kind  # the command of a single integrator is a velocity, that of a double integrator a force
    mass: float  # kg
    damping: float  # N s/m; 0 for a single integrator
    gains: SwarmGains  # of the swarm; the broadcast sums D contain their ksd
    gravity: float  # m/s^2
    period: float  # control period for which a command is held, s


class SwarmLaw(Part[Robot, Command]):
    """A swarm law, which creates the function of one robot; `name` is the value of ``swarm.law.type`` in a scenario."""


def _make_paper(settings: Settings, robot: Robot) -> Command:  # noqa: ARG001 - it uses the gains of the swarm
    mass, damping, gains, gravity = robot.mass, robot.damping, robot.gains, robot.gravity
    if not robot.kind.by_force:  # its velocity is the command of the previous step
        return lambda position, _, abstract, sums, desired: single_integrator_command(
            mass, position, gains, gravity, abstract, sums, desired
        )
    return lambda position, velocity, abstract, sums, desired: double_integrator_command(
        mass, damping, position, velocity, gains, gravity, abstract, sums, desired
    )


PAPER = SwarmLaw("paper", (), _make_paper, "the paper's laws, by the kind of each robot")

LAWS = Registry("swarm law", "swarmabs.swarm_laws", SwarmLaw, (PAPER,), ("__call__",))
