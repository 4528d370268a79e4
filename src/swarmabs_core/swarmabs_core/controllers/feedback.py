"""State feedback on the plane's angle: PD with given gains (eq. ControlLawPD), or with those of the LQR."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import cast

from swarmabs_core.controllers.base import ControllerType, ParentContext
from swarmabs_core.messages import PlaneState
from swarmabs_core.parameters import Parameter, Settings


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


def _make_pd(settings: Settings, context: ParentContext) -> StateFeedback:  # noqa: ARG001
    k1, k2 = cast("tuple[float, float]", settings["gains"])
    return StateFeedback(k1, k2)


def _make_lqr(settings: Settings, context: ParentContext) -> StateFeedback:
    q = cast("tuple[float, float]", settings["q"])
    r = cast("float", settings["r"])
    return StateFeedback(*lqr_gains(q, r, context.inertia + context.manifold.offset, context.friction.g6))


PD = ControllerType(
    "pd",
    (Parameter("gains", (3.1623, 3.2859), "k1 in N m/rad and k2 in N m s/rad", length=2),),
    _make_pd,
)

LQR = ControllerType(
    "lqr",
    (
        Parameter("q", (10.0, 1.0), "diagonal of Q, 1/rad^2 and s^2/rad^2", minimum=0.0, length=2),
        Parameter("r", 1.0, "weight of the torque, 1/(N m)^2", above=0.0),
    ),
    _make_lqr,
)
