"""State feedback on the plane's angle: PD with given gains (eq. ControlLawPD), or with those of the LQR."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from swarmabs_core.controllers.base import ControllerType, ParentContext
from swarmabs_core.declaration import made_of, parameters_of, setting
from swarmabs_core.messages import PlaneState
from swarmabs_core.parameters import SettingError, Settings


@dataclass(frozen=True, slots=True)
class StateFeedback:
    """tau_raw = k1 th + k2 w: regulates the plane to the horizontal.

    Parameters
    ----------
    k1 : float
        N m/rad.
    k2 : float
        N m s/rad.
    """

    k1: float
    k2: float

    def torque(self, time: float, plane: PlaneState) -> float:  # noqa: ARG002
        """Return tau_raw, N m."""
        return self.k1 * plane.angle + self.k2 * plane.angular_velocity

    def offset_torque(self, time: float, plane: PlaneState, offset: float) -> float:  # noqa: ARG002
        """Return tau_raw, N m, that regulates the plane to an offset, rad."""
        return self.k1 * (plane.angle - offset) + self.k2 * plane.angular_velocity

    def reference(self, time: float) -> float:  # noqa: ARG002
        """Return 0 rad: this law regulates."""
        return 0.0


def lqr_gains(q: tuple[float, float], r: float, inertia: float, viscous: float) -> tuple[float, float]:
    r"""Solve the algebraic Riccati equation of the plane linearised at rest, in closed form.

    The plant is :math:`I \dot w = -c w - \tau` with :math:`\dot\theta = w`; minimised is the integral of
    :math:`q_1 \theta^2 + q_2 w^2 + r \tau^2`. The paper's plant has the wrong sign of c, hence its different
    gains.

    Parameters
    ----------
    q : tuple of float
        Diagonal of Q, 1/rad^2 and s^2/rad^2.
    r : float
        1/(N m)^2.
    inertia : float
        I, kg m^2: plane and swarm.
    viscous : float
        c, N m s/rad.

    Returns
    -------
    tuple of float
        k1 (N m/rad) and k2 (N m s/rad) of tau = k1 th + k2 w.
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

    Linearised at 0 with the inertia ``plane.inertia + manifold.offset`` and the viscous friction g6.
    """

    q: tuple[float, float] = setting(
        (10.0, 1.0),
        "diagonal of Q: weight of angle in 1/rad^2 and of angular velocity in s^2/rad^2",
        minimum=0.0,
        length=2,
    )
    r: float = setting(1.0, "weight of the torque, 1/(N m)^2", above=0.0)

    def __post_init__(self) -> None:
        """Refuse that the angle has no weight.

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
