"""Parent controllers: state of the plane in, torque that the swarm should exert out.

State feedback, as PD with given gains (eq. ControlLawPD) or as LQR, and ARISE are built in. To add another, define its
class and its settings here and add its `ControllerType` to `CONTROLLERS`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sqrt
from typing import Protocol, runtime_checkable

from swarmabs_core.declaration import choice, made_of, parameters_of, same, setting
from swarmabs_core.elementary import cos, tanh
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import PlaneState
from swarmabs_core.parameters import SettingError, Settings
from swarmabs_core.plant import Friction, Plane
from swarmabs_core.registry import Part, Registry
from swarmabs_core.trajectory import TRAJECTORY, Derivatives, Trajectory, make_trajectory

__all__ = [
    "CONTROLLERS",
    "TRAJECTORY",
    "ControllerType",
    "ParentContext",
    "ParentController",
    "ParentLaw",
    "Trajectory",
    "make_trajectory",
]

Vector = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class ParentContext:
    """What a parent controller may know about the system that it controls."""

    period: float  # control period, s
    inertia: float  # moment of inertia of the plane alone, kg m^2
    friction: Friction  # of the bearing
    manifold: Manifold  # curve on which the desired abstract state lies


class ParentController(Protocol):
    """A control law for the plane. It may have internal state, so it is called once per step, in order."""

    def torque(self, time: float, plane: PlaneState) -> float:
        """Return the desired torque tau_raw (N m) at a time (s), before it is limited and filtered.

        Raises
        ------
        RunError
            If the law is not defined in this state of the plane.
        """
        ...

    def reference(self, time: float) -> float:
        """Return the reference angle (rad) of the plane at a time (s)."""
        ...


@runtime_checkable
class OffsetController(Protocol):
    """Optional interface of a parent controller whose reference can be offset."""

    def offset_torque(self, time: float, plane: PlaneState, offset: float) -> float:
        """Return the desired torque (N m) for the reference plus an offset (rad).

        It is called instead of `torque` in steps with an offset.
        """
        ...


@runtime_checkable
class RememberingController(Protocol):
    """Optional interface of a parent controller with integrals, so that several instances of it hold them together."""

    @property
    def memory(self) -> tuple[float, ...]:
        """What it remembers beyond the current step; empty before its first step."""
        ...

    def recall(self, memory: tuple[float, ...]) -> None:
        """Remember this instead, which another instance of the same law, or a mean of several, remembers."""
        ...


class ControllerType(Part[ParentContext, ParentController]):
    """A parent controller; `name` is the value of ``controller.type`` in a scenario."""


@dataclass(frozen=True, slots=True)
class StateFeedback:
    """tau_raw = k1 th + k2 w: regulates the plane to the horizontal."""

    k1: float  # N m/rad
    k2: float  # N m s/rad

    def torque(self, time: float, plane: PlaneState) -> float:  # noqa: ARG002
        """Return tau_raw, N m."""
        return self.k1 * plane.angle + self.k2 * plane.angular_velocity

    def offset_torque(self, time: float, plane: PlaneState, offset: float) -> float:  # noqa: ARG002
        """Return tau_raw, N m, that regulates the plane to the offset, rad."""
        return self.k1 * (plane.angle - offset) + self.k2 * plane.angular_velocity

    def reference(self, time: float) -> float:  # noqa: ARG002
        """Return 0 rad: this law is a regulator."""
        return 0.0


def lqr_gains(q: tuple[float, float], r: float, inertia: float, viscous: float) -> tuple[float, float]:
    r"""Solve the algebraic Riccati equation of the plane linearised at rest, in closed form.

    The gains k1 (N m/rad) and k2 (N m s/rad) of tau = k1 th + k2 w minimise the integral of
    :math:`q_1 \theta^2 + q_2 w^2 + r \tau^2` for the plant :math:`I \dot w = -c w - \tau`, :math:`\dot\theta = w`. The
    paper's plant has the wrong sign of c, hence its different gains. `q` is the diagonal of Q (1/rad^2, s^2/rad^2), `r`
    is in 1/(N m)^2, I (kg m^2) is the inertia of plane and swarm, c is in N m s/rad.
    """
    k1 = sqrt(q[0] / r)
    return k1, sqrt(viscous * viscous + q[1] / r + 2.0 * inertia * k1) - viscous


@dataclass(frozen=True, slots=True)
class PdSettings:
    """State feedback with given gains."""

    gains: tuple[float, float] = setting((3.1623, 3.2859), "[k1, k2]: k1 in N m/rad, k2 in N m s/rad", length=2)


@dataclass(frozen=True, slots=True)
class LqrSettings:
    """State feedback with the gain that minimises the integral of z'Qz + r tau^2, z = (th, w).

    The plane is linearised at 0 with the inertia ``plane.inertia + manifold.offset`` and the viscous friction g6.
    """

    q: tuple[float, float] = setting(
        (10.0, 1.0),
        "diagonal of Q: weight of angle in 1/rad^2 and of angular velocity in s^2/rad^2",
        minimum=0.0,
        length=2,
    )
    r: float = setting(1.0, "weight of the torque", unit="1/(N m)^2", above=0.0)

    def __post_init__(self) -> None:
        """Reject a zero weight of the angle.

        Raises
        ------
        SettingError
            If the first weight is 0.
        """
        if self.q[0] == 0.0:
            raise SettingError("q.0", "0 is out of range", "give a number > 0")


def _make_pd(settings: Settings, context: ParentContext) -> StateFeedback:  # noqa: ARG001
    return StateFeedback(*made_of(PdSettings, settings).gains)


def _make_lqr(settings: Settings, context: ParentContext) -> StateFeedback:
    weights = made_of(LqrSettings, settings)
    inertia, viscous = context.inertia + context.manifold.offset, context.friction.g6
    return StateFeedback(*lqr_gains(weights.q, weights.r, inertia, viscous))


PD = ControllerType("pd", parameters_of(PdSettings), _make_pd, "tau_raw = k1 th + k2 w")

LQR = ControllerType(
    "lqr", parameters_of(LqrSettings), _make_lqr, "tau_raw = K (th, w) with K from the algebraic Riccati equation"
)


@dataclass(frozen=True, slots=True)
class PidSettings:
    """State feedback with an integral of the angle, which compensates a constant torque."""

    gains: tuple[float, float, float] = setting(
        (6.68, 3.72, 2.59),
        "[k1, k2, k3]: k1 in N m/rad, k2 in N m s/rad, k3 in N m/(rad s)",
        minimum=0.0,
        length=3,
    )
    integral_limit: float = setting(
        0.5,
        "largest torque of the integral, which grows only while |k1 th| is not above it",
        unit="N m",
        minimum=0.0,
    )


class Pid:
    r"""State feedback with an integral, tau_raw = k1 th + k2 w + z, for a control period in s.

    .. math::

        \dot z = k_3 \theta \quad \text{if } z \theta < 0, \text{ or }
        k_1 |\theta| \le Z \text{ and } |\tau_{raw}| \le \tau_{max}; \qquad \dot z = 0 \quad \text{otherwise}

    and z stays within +-Z, the integral's limit. A torque that the swarm does not exert, because of the limit of the
    torque, the ends of the lanes or missing robots, moves the plane away from its reference. Then :math:`k_1 |\theta|`
    exceeds Z, the integral no longer grows, and on the way back it has not grown either. A constant torque up to Z is
    compensated, because the plane would come to rest where :math:`k_1 |\theta|` is not above it.
    Euler's method advances the integral.
    """

    def __init__(self, settings: PidSettings, period: float, torque_max: float) -> None:
        self.gains = settings.gains
        self.integral_limit = settings.integral_limit
        self._torque_max = torque_max
        self._period = period
        self._integral = 0.0

    @property
    def memory(self) -> tuple[float, ...]:
        """The integral, N m."""
        return (self._integral,)

    def recall(self, memory: tuple[float, ...]) -> None:
        """Continue from an integral (N m), within its limit."""
        self._integral = min(max(memory[0], -self.integral_limit), self.integral_limit)

    def reference(self, time: float) -> float:  # noqa: ARG002
        """Return 0 rad: this law is a regulator."""
        return 0.0

    def torque(self, time: float, plane: PlaneState) -> float:
        """Return tau_raw, N m, and advance the integral by one period."""
        return self.offset_torque(time, plane, 0.0)

    def offset_torque(self, time: float, plane: PlaneState, offset: float) -> float:  # noqa: ARG002
        """Return tau_raw, N m, that regulates the plane to the offset, rad, and advance the integral by one period."""
        k1, k2, k3 = self.gains
        error, integral, limit = plane.angle - offset, self._integral, self.integral_limit
        tau = k1 * error + k2 * plane.angular_velocity + integral
        if integral * error < 0.0 or (k1 * abs(error) <= limit and abs(tau) <= self._torque_max):
            self._integral = min(max(integral + self._period * k3 * error, -limit), limit)
        return tau


def _make_pid(settings: Settings, context: ParentContext) -> Pid:
    return Pid(made_of(PidSettings, settings), context.period, context.manifold.torque_max)


PID = ControllerType("pid", parameters_of(PidSettings), _make_pid, "tau_raw = k1 th + k2 w + the integral of k3 th")


@dataclass(frozen=True, slots=True)
class AriseGains:
    """Gains of the ARISE controller."""

    ks: float = setting(1.0, "gain of the filtered error", unit="N m s/rad", minimum=0.0)
    alpha1: float = setting(1.0, "gain of the angle error in e2", unit="1/s", above=0.0)
    alpha2: float = setting(2.0, "gain of e2 in the integral", unit="1/s", above=0.0)
    beta: float = setting(0.5, "gain of the robust (sign) term", unit="N m/s", minimum=0.0)
    gamma: Vector = setting(
        (10.0, 1.0, 1.0, 10.0), "diagonal of the adaptation gain, one for each parameter", minimum=0.0, length=4
    )
    smoothing: float = setting(
        0.03, "width of tanh(e2/smoothing), which replaces sgn(e2) in sampled time", unit="rad/s", above=0.0
    )
    adaptive_initial: Vector = setting(
        (0.4566, 0.009, 0.01, 0.9),
        "initial estimates of the inertia in kg m^2, of g1 and g4 in N m, and of g6 in N m s/rad",
        length=4,
    )


def regressor(friction: Friction, rates: tuple[float, float, float, float]) -> tuple[Vector, Vector, Vector]:
    """Return Y_d (eq. adaptiveTerm) and its first two time derivatives from the first four derivatives of th_d.

    Only the slopes g2, g3, g5 of the friction are used; its amplitudes are adapted.
    """
    w, dw, ddw, dddw = rates

    def smooth_sign(slope: float) -> tuple[float, float, float]:
        t = tanh(slope * w)
        rise = slope * (1.0 - t * t)
        return t, rise * dw, rise * (ddw - 2.0 * slope * t * dw * dw)

    _, g2, g3, _, g5, _ = friction
    steep, less = smooth_sign(g2), smooth_sign(g3)
    coulomb = steep if g5 == g2 else smooth_sign(g5)
    return (
        (dw, steep[0] - less[0], coulomb[0], w),
        (ddw, steep[1] - less[1], coulomb[1], dw),
        (dddw, steep[2] - less[2], coulomb[2], ddw),
    )


class Arise:
    r"""Adaptive robust integral of the sign of the error (eq. controlLaw to controlLaw4), for a control period in s.

    With :math:`e_1 = \theta_d - \theta` and :math:`e_2 = \dot e_1 + \alpha_1 e_1`:

    .. math::

        \tau = -\sec\theta\,(Y_d \hat\lambda + (k_s + 1)(e_2 - e_2(0)) + \mu_1), \qquad
        \dot\mu_1 = (k_s + 1) \alpha_2 e_2 + \beta\,\mathrm{sgn}(e_2)

        \hat\lambda = \hat\lambda(0) + \Gamma (\dot Y_d^T e_2 |_0^t - \mu_2), \qquad
        \dot\mu_2 = (\ddot Y_d - \alpha_2 \dot Y_d)^T e_2

    eq. controlLaw3 prints the derivative of :math:`\hat\lambda` on its left-hand side, but its right-hand side is
    :math:`\hat\lambda` itself. In sampled time tanh(e2/smoothing) replaces sgn to avoid chattering, and Euler's method
    advances the integrals.
    """

    def __init__(self, gains: AriseGains, trajectory: Trajectory, friction: Friction, period: float) -> None:
        self.gains = gains
        self.trajectory = trajectory
        self._friction = friction
        self._period = period
        self._mu1 = 0.0
        self._mu2: Vector = (0.0, 0.0, 0.0, 0.0)
        self._initial: tuple[float, Vector] | None = None

    @property
    def memory(self) -> tuple[float, ...]:
        """Both integrals mu1 and mu2, and the initial values e2(0) and Y_d'(0) e2(0); empty before the first step."""
        return () if self._initial is None else (self._mu1, *self._mu2, self._initial[0], *self._initial[1])

    def recall(self, memory: tuple[float, ...]) -> None:
        """Continue from these integrals and initial values."""
        mu1, a, b, c, d, e2, p, q, r, s = memory
        self._mu1, self._mu2, self._initial = mu1, (a, b, c, d), (e2, (p, q, r, s))

    def reference(self, time: float) -> float:
        """Return th_d, rad."""
        return self.trajectory.derivatives(time)[0]

    def torque(self, time: float, plane: PlaneState) -> float:
        """Return tau_raw, N m, and advance the integrals by one period.

        The angle must be within +-pi/2, where its secant is finite.
        """
        return self._advance(self.trajectory.derivatives(time), plane)

    def offset_torque(self, time: float, plane: PlaneState, offset: float) -> float:
        """Return tau_raw, N m, for th_d + offset (rad); the derivatives are those of th_d."""
        angle, *rates = self.trajectory.derivatives(time)
        w, dw, ddw, dddw = rates
        return self._advance((angle + offset, w, dw, ddw, dddw), plane)

    def _advance(self, reference: Derivatives, plane: PlaneState) -> float:
        g, dt = self.gains, self._period
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


CONTROLLERS = Registry(
    "parent controller", "swarmabs.parent_controllers", ControllerType, (PD, LQR, PID, ARISE), ("torque", "reference")
)


@dataclass(frozen=True, slots=True)
class ParentLaw:
    """The control law of the plane, and the properties of the plane that it knows."""

    controller: str = choice(CONTROLLERS.find, CONTROLLERS.built_in, PD.name, "control law of the plane")
    controller_settings: Settings = field(default_factory=dict, hash=False)
    inertia: float = same(Plane, "inertia", name="plane.inertia")
    friction: Friction = same(Plane, "friction", name="plane.friction")
    height_compensation: bool = setting(
        default=False,
        description="whether g H tan(th) is added to the torque of the law, against the weight above the axis",
    )
    moment: float = setting(
        0.0,
        "first moment H of the masses above the axis, sum m h of robots and plane",
        unit="kg m",
        name="plane.moment",
    )

    @property
    def compensated(self) -> float:
        """The first moment H (kg m) whose weight is compensated."""
        return self.moment if self.height_compensation else 0.0

    def make(self, period: float, manifold: Manifold) -> ParentController:
        """Return the law in its initial state, for a control period (s) and the manifold of the swarm."""
        context = ParentContext(period, self.inertia, self.friction, manifold)
        return CONTROLLERS.make(self.controller, self.controller_settings, context)
