"""The laws of the paper as printed, with the errors that docs/explanation/errata.md lists, to compare them on a rig.

The folder beside this module, ``printed_laws-1.0.dist-info``, makes it a package of swarmabs wherever this folder is on
the search path: ``swarm.law.type: printed`` and ``controller.type: printed_arise``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.controllers import ARISE, AriseGains, ControllerType, ParentContext, make_trajectory, regressor
from swarmabs_core.declaration import made_of
from swarmabs_core.elementary import cos, tanh
from swarmabs_core.swarm_law import Command, Robot, SwarmLaw

if TYPE_CHECKING:
    from swarmabs_core.messages import AbstractState, AuxiliaryState, DesiredAbstractState, PlaneState
    from swarmabs_core.parameters import Settings
    from swarmabs_core.swarm_law import Pair


def printed_row(mass: float, position: float, sums: AuxiliaryState) -> Pair:
    """Return a robot's row of eq. pinv as printed: the first entry lacks a division by g; mass in kg, position in m."""
    return (
        mass * (sums.s2 - position * sums.s1) / sums.s3,
        mass * (position * sums.s0 - sums.s1) / (2.0 * sums.s3),
    )


def printed_damping(sums: AuxiliaryState) -> tuple[float, float, float, float]:
    """Return C_a as printed, row by row: it lacks the division by S3, and g off the diagonal."""
    s0, s1, s2, d0, d1, d2 = sums.s0, sums.s1, sums.s2, sums.d0, sums.d1, sums.d2
    return s2 * d0 - s1 * d1, 0.5 * (s0 * d1 - s1 * d0), 2.0 * (s2 * d1 - s1 * d2), s0 * d2 - s1 * d1


def _make_law(settings: Settings, robot: Robot) -> Command:  # noqa: ARG001 - it uses the gains of the swarm
    mass, damping, gains = robot.mass, robot.damping, robot.gains

    def velocity_of(
        position: float,
        velocity: float,  # noqa: ARG001 - it is the command of the previous step
        abstract: AbstractState,
        sums: AuxiliaryState,
        desired: DesiredAbstractState,
    ) -> float:
        r0, r1 = printed_row(mass, position, sums)
        y0 = gains.k[0] * (desired.torque - abstract.torque) + desired.mean_torque_rate
        return r0 * y0 + r1 * (gains.k[1] * (desired.inertia - abstract.inertia) + desired.mean_inertia_rate)

    def force_of(
        position: float,
        velocity: float,
        abstract: AbstractState,
        sums: AuxiliaryState,
        desired: DesiredAbstractState,
    ) -> float:
        r0, r1 = printed_row(mass, position, sums)
        c00, c01, c10, c11 = printed_damping(sums)
        de0, de1 = desired.torque_rate - abstract.torque_rate, desired.inertia_rate - abstract.inertia_rate
        y0 = gains.kp[0] * (desired.torque - abstract.torque) + (gains.kd[0] - c00) * de0 - c01 * de1
        y1 = gains.kp[1] * (desired.inertia - abstract.inertia) - c10 * de0 + (gains.kd[1] - c11) * de1
        y0 += desired.torque_acceleration
        # Printed is the robot's own Phi' p', not the sum over the swarm.
        y1 += desired.inertia_acceleration - 2.0 * mass * velocity * velocity
        forward = (damping + gains.ksd) * (r0 * desired.torque_rate + r1 * desired.inertia_rate)
        return mass * (r0 * y0 + r1 * y1) + forward - gains.ksd * velocity

    return force_of if robot.kind.by_force else velocity_of


class PrintedArise:
    """ARISE with eq. controlLaw3 as printed: what should be the estimate is its rate.

    Parameters
    ----------
    settings : mapping
        Those of ``controller.type: arise``.
    context : ParentContext
        What the law may know of the plane.
    """

    def __init__(self, settings: Settings, context: ParentContext) -> None:
        self._gains = made_of(AriseGains, settings)
        self._trajectory = make_trajectory(settings)
        self._friction, self._period = context.friction, context.period
        self._estimates = self._gains.adaptive_initial
        self._mu1 = 0.0
        self._mu2 = 0.0, 0.0, 0.0, 0.0
        self._initial: tuple[float, tuple[float, ...]] | None = None

    def reference(self, time: float) -> float:
        """Return th_d (rad) at a time (s)."""
        return self._trajectory.derivatives(time)[0]

    def torque(self, time: float, plane: PlaneState) -> float:
        """Return tau_raw, N m, and advance the integrals by one period."""
        g, dt = self._gains, self._period
        angle, *rates = self._trajectory.derivatives(time)
        w, dw, ddw, dddw = rates
        y, dy, ddy = regressor(self._friction, (w, dw, ddw, dddw))
        e2 = (w - plane.angular_velocity) + g.alpha1 * (angle - plane.angle)
        if self._initial is None:
            self._initial = e2, tuple(d * e2 for d in dy)
        start, dye2_start = self._initial
        terms = zip(y, self._estimates, strict=True)
        tau = -(sum(a * b for a, b in terms) + (g.ks + 1.0) * (e2 - start) + self._mu1) / cos(plane.angle)
        self._mu1 += dt * ((g.ks + 1.0) * g.alpha2 * e2 + g.beta * tanh(e2 / g.smoothing))
        parts = zip(self._estimates, g.adaptive_initial, g.gamma, dy, dye2_start, self._mu2, strict=True)
        advanced = [value + dt * (first + gamma * (d * e2 - d0 - mu)) for value, first, gamma, d, d0, mu in parts]
        integrals = [mu + dt * (dd - g.alpha2 * d) * e2 for mu, dd, d in zip(self._mu2, ddy, dy, strict=True)]
        self._estimates = advanced[0], advanced[1], advanced[2], advanced[3]
        self._mu2 = integrals[0], integrals[1], integrals[2], integrals[3]
        return tau


PRINTED = SwarmLaw("printed", (), _make_law, "the paper's laws as printed")
PRINTED_ARISE = ControllerType("printed_arise", ARISE.settings, PrintedArise, "ARISE as printed")
