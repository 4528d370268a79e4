r"""The paper's estimate of the region of attraction of a PD-controlled plane (theorem LQR_SI), printed and corrected.

With the error :math:`z = (\theta, \dot\theta, e_\tau, e_J)` the estimate is the ball

.. math:: S = \{ z : |z|^2 \le \theta_{max}^2 / (2 \eta) \}

for which the paper prints two values of :math:`\eta`: one in the theorem, another in its proof. The latter is the
right bound of the kinetic energy's coefficient, so it is the corrected one here; see docs/sweep.md. The paper also
takes the abstract state without g for its error; here :math:`e_a(0) = a_d(0) - a(0)`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.controllers.feedback import StateFeedback
from swarmabs_core.messages import PlaneState

if TYPE_CHECKING:
    from swarmabs_core.theory.report import Document
    from swarmabs_core.theory.setting import Setting

ANGLE_MAX = 0.2
"""The paper's bound theta_max of the angle, rad."""


def printed_eta(inertia: float, largest_inertia: float) -> float:
    """Return eta = max{1, (J + J_sd,max)/2} of the theorem.

    Parameters
    ----------
    inertia : float
        Moment of inertia J of the plane alone, kg m^2.
    largest_inertia : float
        Largest inertia J_sd,max asked of the swarm, kg m^2.
    """
    return max(1.0, 0.5 * (inertia + largest_inertia))


def corrected_eta(inertia: float, largest_inertia: float) -> float:
    """Return eta = max{1/2, (J + J_sd,max)/2} of the theorem's proof; parameters as of `printed_eta`."""
    return max(0.5, 0.5 * (inertia + largest_inertia))


def radius_squared(angle_max: float, eta: float) -> float:
    """Return theta_max^2/(2 eta), below which |z|^2 lies in the estimate; `angle_max` in rad."""
    return angle_max * angle_max / (2.0 * eta)


def balls(square: float, printed: float, corrected: float) -> dict[str, Document]:
    """Return how an initial |z|^2 lies in the estimates, of which these are the largest |z|^2."""
    return {
        "initial_error_squared": square,
        "printed_radius_squared": printed,
        "in_printed_ball": square <= printed,
        "corrected_radius_squared": corrected,
        "in_corrected_ball": square <= corrected,
    }


class Estimate(NamedTuple):
    """The estimates for one setting, as functions of the plane's initial state.

    Parameters
    ----------
    setting : Setting
        The setting; the swarm's initial abstract state is its own.
    printed, corrected : float
        Largest |z|^2 of the printed and of the corrected estimate.
    """

    setting: Setting
    printed: float
    corrected: float

    def error_squared(self, angle: float, angular_velocity: float) -> float:
        """Return |z|^2 of an initial state of the plane, in rad and rad/s, with this swarm.

        The desired abstract state starts, unfiltered, at the limited torque that the controller asks for.
        """
        manifold, swarm = self.setting.manifold, self.setting.initial
        wanted = manifold.clip(self.setting.law.torque(0.0, PlaneState(0, 0, angle, angular_velocity)))
        e_torque = wanted - swarm.torque
        e_inertia = manifold.inertia(wanted) - swarm.inertia
        return angle * angle + angular_velocity * angular_velocity + e_torque * e_torque + e_inertia * e_inertia


def estimate(setting: Setting) -> Estimate | None:
    """Return the estimates for a setting; None if its parent controller is no state feedback."""
    if not isinstance(setting.law, StateFeedback):
        return None
    manifold = setting.manifold
    inertias = (setting.plane.inertia, manifold.inertia(manifold.torque_max))
    return Estimate(
        setting,
        radius_squared(setting.angle_max, printed_eta(*inertias)),
        radius_squared(setting.angle_max, corrected_eta(*inertias)),
    )
