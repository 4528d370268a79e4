r"""Adaptive robust integral of the sign of the error (eq. controlLaw to controlLaw4).

With :math:`e_1 = \theta_d - \theta` and :math:`e_2 = \dot e_1 + \alpha_1 e_1`:

.. math::

    \tau = -\sec\theta\,(Y_d \hat\lambda + (k_s + 1)(e_2 - e_2(0)) + \mu_1), \qquad
    \dot\mu_1 = (k_s + 1) \alpha_2 e_2 + \beta\,\mathrm{sgn}(e_2)

    \hat\lambda = \hat\lambda(0) + \Gamma (\dot Y_d^T e_2 |_0^t - \mu_2), \qquad
    \dot\mu_2 = (\ddot Y_d - \alpha_2 \dot Y_d)^T e_2

eq. controlLaw3 prints the derivative of :math:`\hat\lambda` on its left; its right-hand side is
:math:`\hat\lambda` itself. In sampled time sgn is tanh(e2/smoothing), which does not chatter, and the
integrals are advanced by Euler's method.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, tanh

from swarmabs_core.controllers.base import ControllerType, ParentContext, Trajectory
from swarmabs_core.controllers.reference import TRAJECTORY, make_trajectory
from swarmabs_core.declaration import made_of, parameters_of, setting
from swarmabs_core.friction import Friction
from swarmabs_core.messages import PlaneState
from swarmabs_core.parameters import Settings
from swarmabs_core.trajectory import Derivatives

Vector = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class AriseGains:
    """Gains of the ARISE controller."""

    ks: float = setting(1.0, "gain of the filtered error, N m s/rad", minimum=0.0)
    alpha1: float = setting(1.0, "gain of the angle error in e2, 1/s", above=0.0)
    alpha2: float = setting(2.0, "gain of e2 in the integral, 1/s", above=0.0)
    beta: float = setting(0.5, "gain of the robust (sign) term, N m/s", minimum=0.0)
    gamma: Vector = setting(
        (10.0, 1.0, 1.0, 10.0), "diagonal of the adaptation gain, one for each parameter", minimum=0.0, length=4
    )
    smoothing: float = setting(
        0.03, "width of tanh(e2/smoothing), which stands for sgn(e2) in sampled time, rad/s", above=0.0
    )
    adaptive_initial: Vector = setting(
        (0.4566, 0.009, 0.01, 0.9),
        "initial estimates of the inertia in kg m^2, of g1 and g4 in N m, and of g6 in N m s/rad",
        length=4,
    )


def regressor(friction: Friction, rates: tuple[float, float, float, float]) -> tuple[Vector, Vector, Vector]:
    """Return Y_d (eq. adaptiveTerm) and its first two time derivatives.

    Parameters
    ----------
    friction : Friction
        Only the slopes g2, g3, g5 are used; the amplitudes are what is adapted.
    rates : tuple of float
        First to fourth derivative of th_d.
    """
    w, dw, ddw, dddw = rates
    value, first, second = [], [], []
    for slope in (friction.g2, friction.g3, friction.g5):
        t = tanh(slope * w)
        sech2 = 1.0 - t * t
        value.append(t)
        first.append(slope * sech2 * dw)
        second.append(slope * sech2 * (ddw - 2.0 * slope * t * dw * dw))
    return (
        (dw, value[0] - value[1], value[2], w),
        (ddw, first[0] - first[1], first[2], dw),
        (dddw, second[0] - second[1], second[2], ddw),
    )


class Arise:
    """ARISE controller of the plane's angle.

    Parameters
    ----------
    gains : AriseGains
        Gains.
    trajectory : Trajectory
        Reference of the angle.
    friction : Friction
        Where the slopes g2, g3, g5 of the regressor come from.
    period : float
        Control period, s.
    """

    def __init__(self, gains: AriseGains, trajectory: Trajectory, friction: Friction, period: float) -> None:
        self._gains = gains
        self._trajectory = trajectory
        self._friction = friction
        self._period = period
        self._mu1 = 0.0
        self._mu2: Vector = (0.0, 0.0, 0.0, 0.0)
        self._initial: tuple[float, Vector] | None = None

    @property
    def gains(self) -> AriseGains:
        """The gains of the law."""
        return self._gains

    @property
    def trajectory(self) -> Trajectory:
        """The reference of the angle."""
        return self._trajectory

    def reference(self, time: float) -> float:
        """Return th_d, rad."""
        return self._trajectory.derivatives(time)[0]

    def torque(self, time: float, plane: PlaneState) -> float:
        """Return tau_raw, N m, and advance the integrals by one period.

        The angle must be within +-pi/2, where its secant is finite.
        """
        return self._advance(self._trajectory.derivatives(time), plane)

    def offset_torque(self, time: float, plane: PlaneState, offset: float) -> float:
        """Return tau_raw, N m, for th_d + offset (rad); the derivatives are those of th_d."""
        angle, *rates = self._trajectory.derivatives(time)
        w, dw, ddw, dddw = rates
        return self._advance((angle + offset, w, dw, ddw, dddw), plane)

    def _advance(self, reference: Derivatives, plane: PlaneState) -> float:
        g, dt = self._gains, self._period
        angle, w, dw, ddw, dddw = reference
        y, dy, ddy = regressor(self._friction, (w, dw, ddw, dddw))
        e2 = (w - plane.angular_velocity) + g.alpha1 * (angle - plane.angle)
        if self._initial is None:
            self._initial = (e2, (dy[0] * e2, dy[1] * e2, dy[2] * e2, dy[3] * e2))
        e2_initial, dye2_initial = self._initial
        feed_forward = 0.0
        for i in range(4):
            estimate = g.adaptive_initial[i] + g.gamma[i] * (dy[i] * e2 - dye2_initial[i] - self._mu2[i])
            feed_forward += y[i] * estimate
        ks1 = g.ks + 1.0
        tau = -(feed_forward + ks1 * (e2 - e2_initial) + self._mu1) / cos(plane.angle)
        self._mu1 += dt * (ks1 * g.alpha2 * e2 + g.beta * tanh(e2 / g.smoothing))
        m = self._mu2
        rate = [(ddy[i] - g.alpha2 * dy[i]) * e2 for i in range(4)]
        self._mu2 = (m[0] + dt * rate[0], m[1] + dt * rate[1], m[2] + dt * rate[2], m[3] + dt * rate[3])
        return tau


def _make(settings: Settings, context: ParentContext) -> Arise:
    return Arise(made_of(AriseGains, settings), make_trajectory(settings), context.friction, context.period)


ARISE = ControllerType(
    "arise",
    (*parameters_of(AriseGains), *TRAJECTORY),
    _make,
    "adaptive robust integral of the sign of the error",
)
