r"""Local exponential stability of a plane under the PID controller, which is beyond the paper.

A constant torque d on the plane, up to the limit Z of the integral, is in equilibrium with :math:`\theta = w = 0`,
:math:`z = \tau = -d` and the inertia :math:`J_s = A d^2 + B`. There the right-hand side is smooth, and linearised it is
block triangular: the errors of the swarm decay by themselves, and the plane has the characteristic polynomial

.. math:: (J + J_s) s^3 + (k_2 + \gamma) s^2 + (k_1 - h) s + k_3

with the slope :math:`\gamma` of the friction at rest, and h the weight of masses above the axis, unless the controller
compensates it; the reaction of these masses is omitted. By Routh and Hurwitz all roots have negative real parts if and
only if :math:`k_1 > h`, :math:`k_3 > 0` and :math:`(k_2 + \gamma)(k_1 - h) > (J + J_s) k_3`; by Lyapunov's indirect
method the equilibrium is then exponentially stable. The conditions are evaluated for the least :math:`f_f(w)/w`, which
is at most that slope, and the largest inertia.
"""

from __future__ import annotations

from dataclasses import replace
from math import nan
from typing import TYPE_CHECKING

from swarmabs_core.controllers import Pid
from swarmabs_core.theory.error_dynamics import gain_conditions
from swarmabs_core.theory.report import Condition, Form, Theorem
from swarmabs_core.theory.state_feedback import least_viscous, undisturbed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.theory.setting import Setting


def hurwitz_conditions(
    gains: tuple[float, float, float], inertia: float, slope: float, toppling: float = 0.0
) -> Iterator[Condition]:
    """Yield the conditions for all roots of the characteristic polynomial to have negative real parts.

    Parameters
    ----------
    gains : tuple of float
        k1 (N m/rad), k2 (N m s/rad) and k3 (N m/(rad s)).
    inertia : float
        Moment of inertia of plane and swarm, kg m^2.
    slope : float
        Slope of the friction, N m s/rad.
    toppling : float
        Torque per angle by which weights above the axis push the plane over, N m/rad.
    """
    k1, k2, k3 = gains
    stiffness = k1 - toppling
    yield Condition("k1", None, Form("k1 > h", k1, toppling), {"k1": k1, "h": toppling})
    yield Condition("k3", None, Form("k3 > 0", k3, 0.0), {"k3": k3})
    yield Condition(
        "Routh",
        None,
        Form("(k2 + gamma) (k1 - h) > (J + Js) k3", (k2 + slope) * stiffness, inertia * k3),
        {"k1": k1, "k2": k2, "k3": k3, "gamma": slope, "h": toppling, "inertia": inertia},
        "gamma: least f_f(w)/w; Js: on the manifold at the limit of the integral",
    )


def check_pid(setting: Setting) -> Theorem | None:
    """Evaluate the conditions of local exponential stability; return None for other parent controllers."""
    law, plane, manifold = setting.law, setting.plane, setting.manifold
    if not isinstance(law, Pid):
        return None
    limit = law.integral_limit
    reach = setting.sets.admissible_reach(manifold.curvature, manifold.offset)
    return Theorem(
        "PID",
        "beyond the paper: local exponential stability with PID",
        (
            *hurwitz_conditions(
                law.gains, setting.body_inertia + manifold.inertia(limit), least_viscous(plane.friction), setting.weight
            ),
            Condition(
                "integral limit",
                None,
                Form("integral_limit < torque that the swarm can exert", limit, min(manifold.torque_max, reach), "<"),
                {"integral_limit": limit, "torque_max": manifold.torque_max, "admissible_torque": reach},
                "admissible: all positions with this torque and its inertia are on the plane",
            ),
            undisturbed(setting, "the integral compensates a constant torque; a sine leaves an error"),
            *(replace(condition, printed=None) for condition in gain_conditions(setting)),
            Condition(
                "initial state",
                None,
                Form("in a proven region of attraction", nan, nan, unknown=True),
                {"angle": plane.angle, "angular_velocity": plane.angular_velocity},
                "the theorem is local: it proves no region; docs/explanation/theory.md names a simulated one",
            ),
        ),
    )
