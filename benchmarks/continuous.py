r"""The closed loop of single integrators under the PD controller in continuous time, solved by SciPy.

.. math::

    (J + J_s) \dot w = -\cos(\theta) \tau_s - \dot J_s w - f_f(w) - \tau_d(t), \qquad \dot\theta = w, \qquad
    \dot p = \Phi^+ (K (a_d - a) + \dot a_d)

with the desired abstract state on the manifold behind the command filter. This is what you would write in a
notebook: without sampling, processes and messages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.integrate import solve_ivp

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from swarmabs_config.scenario import PlaneScenario

    Array = NDArray[np.float64]

METHOD: Final = "LSODA"
RTOL, ATOL = 1e-8, 1e-10
_BANDWIDTH = 50.0
"""Bandwidth of the command filter, rad/s."""


def solve(scenario: PlaneScenario) -> Array:
    """Return the angle of the plane, rad, at all steps of a scenario.

    Parameters
    ----------
    scenario : PlaneScenario
        Must have only single integrators, the PD controller and no faults.
    """
    plane, curve = scenario.plane, scenario.manifold
    g, (g1, g2, g3, g4, g5, g6) = plane.gravity, plane.friction
    m = np.array([agent.mass for agent in scenario.agents])
    k = np.array(scenario.swarm.gains.k)
    k1, k2 = scenario.controller.model_dump(by_alias=True)["gains"]

    def rhs(t: float, x: Array) -> Array:
        th, w, tau, dtau = x[:4]
        p = x[4:]
        raw = min(max(k1 * th + k2 * w, -curve.torque_max), curve.torque_max)
        ddtau = _BANDWIDTH**2 * (raw - tau) - 2.0 * _BANDWIDTH * dtau
        desired = np.array([tau, curve.curvature * tau**2 + curve.offset])
        rate = np.array([dtau, 2.0 * curve.curvature * tau * dtau])
        phi = np.stack([g * m, 2.0 * m * p])
        torque, inertia = g * m @ p, m @ p**2
        v = np.linalg.pinv(phi) @ (k * (desired - np.array([torque, inertia])) + rate)
        friction = g1 * (np.tanh(g2 * w) - np.tanh(g3 * w)) + g4 * np.tanh(g5 * w) + g6 * w
        load = plane.disturbance.amplitude * np.sin(plane.disturbance.angular_frequency * t)
        dw = (-np.cos(th) * torque - phi[1] @ v * w - friction - load) / (plane.inertia + inertia)
        return np.concatenate([[w, dw, dtau, ddtau], v])

    tau0 = min(max(k1 * plane.angle + k2 * plane.angular_velocity, -curve.torque_max), curve.torque_max)
    start = np.concatenate([[plane.angle, plane.angular_velocity, tau0, 0.0], [a.position for a in scenario.agents]])
    time = np.arange(scenario.steps + 1) * scenario.period
    found = solve_ivp(rhs, (0.0, time[-1]), start, METHOD, t_eval=time, rtol=RTOL, atol=ATOL)
    return np.asarray(found.y[0], dtype=np.float64)
