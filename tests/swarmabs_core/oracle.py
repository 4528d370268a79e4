"""The closed loop in continuous time, written from the equations alone and solved by SciPy.

It shares nothing with the package but the scenario's numbers: neither its functions nor its sampled form.
Single integrators have their velocity at once, the command filter sees tau_raw continuously, and sgn(e2) is
tanh(e2/smoothing).
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from swarmabs_config.scenario import Scenario

    Array = NDArray[np.float64]

FILTER_BANDWIDTH = 50.0


class Solution(NamedTuple):
    """Angle (rad), torque (N m) and inertia (kg m^2) of the swarm at the steps of the scenario."""

    time: Array
    angle: Array
    torque: Array
    inertia: Array


class _Pd:
    """tau_raw = k1 th + k2 w; it has no state of its own."""

    def __init__(self, scenario: Scenario) -> None:
        self._gains = scenario.controller.model_dump(by_alias=True)["gains"]

    def __call__(self, t: float, th: float, w: float, mu: Array) -> tuple[float, Array]:
        return self._gains[0] * th + self._gains[1] * w, np.zeros(5)


class _Arise:
    """ARISE on the sine trajectory; mu = (mu1, mu2) is integrated with the loop."""

    def __init__(self, scenario: Scenario) -> None:
        given = scenario.controller.model_dump(by_alias=True)
        c = SimpleNamespace(**{**given, "trajectory": SimpleNamespace(**given["trajectory"])})
        self._c = c
        self._slopes = np.array([scenario.plane.friction[i] for i in (1, 2, 4)])
        self._gamma, self._lam0 = np.array(c.gamma), np.array(c.adaptive_initial)
        _, dy, _ = self._regressor(0.0)
        e2 = self._e2(0.0, scenario.plane.angle, scenario.plane.angular_velocity)
        self._e2_0, self._dye2_0 = e2, dy * e2

    def _th_d(self, t: float, n: int) -> float:
        """n-th derivative of the sine."""
        a, f = self._c.trajectory.amplitude, self._c.trajectory.angular_frequency
        return float(a * f**n * np.sin(f * t + n * np.pi / 2))

    def _e2(self, t: float, th: float, w: float) -> float:
        return self._th_d(t, 1) - w + self._c.alpha1 * (self._th_d(t, 0) - th)

    def _regressor(self, t: float) -> tuple[Array, Array, Array]:
        w, dw, ddw, dddw = (self._th_d(t, n) for n in (1, 2, 3, 4))
        g = self._slopes
        x = np.clip(g * w, -300, 300)
        y, s = np.tanh(x), np.cosh(x) ** -2
        dy = g * dw * s
        ddy = g * ddw * s - 2 * (g * dw) ** 2 * s * y

        def combine(first: float, q: Array, last: float) -> Array:
            return np.array([first, q[0] - q[1], q[2], last])

        return combine(dw, y, w), combine(ddw, dy, dw), combine(dddw, ddy, ddw)

    def __call__(self, t: float, th: float, w: float, mu: Array) -> tuple[float, Array]:
        c = self._c
        y, dy, ddy = self._regressor(t)
        e2 = self._e2(t, th, w)
        lam = self._lam0 + self._gamma * (dy * e2 - self._dye2_0 - mu[1:])
        tau = -(y @ lam + (c.ks + 1) * (e2 - self._e2_0) + mu[0]) / np.cos(th)
        dmu1 = (c.ks + 1) * c.alpha2 * e2 + c.beta * np.tanh(e2 / c.smoothing)
        return tau, np.concatenate([[dmu1], (ddy - c.alpha2 * dy) * e2])


def _closed_loop(
    scenario: Scenario,
) -> tuple[Callable[[float, Array], Array], Array, Callable[[Array], tuple[Array, Array]]]:
    """Return the right-hand side, the initial state and a function from states to (torque, inertia)."""
    plane, gains, curve = scenario.plane, scenario.swarm.gains, scenario.manifold
    g, (g1, g2, g3, g4, g5, g6) = plane.gravity, plane.friction
    m = np.array([a.mass for a in scenario.agents])
    c = np.array([a.damping for a in scenario.agents])
    di = np.array([a.kind == "double_integrator" for a in scenario.agents])
    count, k, kp, kd, ksd = len(m), np.array(gains.k), np.array(gains.kp), np.array(gains.kd), gains.ksd
    law = {"pd": _Pd, "arise": _Arise}[scenario.controller.type](scenario)
    mc = np.where(di, m * (c + ksd), 0.0)

    def rhs(t: float, x: Array) -> Array:
        th, w, tau, dtau = x[:4]
        p = x[9 : 9 + count]
        raw, dmu = law(t, th, w, x[4:9])
        command = np.clip(raw, -curve.torque_max, curve.torque_max)
        ddtau = FILTER_BANDWIDTH**2 * (command - tau) - 2 * FILTER_BANDWIDTH * dtau
        a_d = np.array([tau, curve.curvature * tau**2 + curve.offset])
        da_d = np.array([dtau, 2 * curve.curvature * tau * dtau])
        dda_d = np.array([ddtau, 2 * curve.curvature * (dtau**2 + tau * ddtau)])

        phi = np.stack([g * m, 2 * m * p])
        pinv = np.linalg.pinv(phi)
        a = np.array([g * m @ p, m @ p**2])
        e = a_d - a
        v = pinv @ (k * e + da_d)
        v[di] = x[9 + count :]
        da, q = phi @ v, m @ v**2
        de = da_d - da
        # Phi diag((c + ksd)/m over the double integrators) pinv: what the printed C_a should have been.
        c_a = phi @ (pinv * (mc / m**2)[:, None])
        target = kp * e + kd * de - c_a @ de - np.array([0.0, 2 * q]) + dda_d
        u = m * (pinv @ target) + (c + ksd) * (pinv @ da_d) - ksd * v
        friction = g1 * (np.tanh(g2 * w) - np.tanh(g3 * w)) + g4 * np.tanh(g5 * w) + g6 * w
        disturbance = plane.disturbance.amplitude * np.sin(plane.disturbance.angular_frequency * t)
        dw = (-np.cos(th) * a[0] - da[1] * w - friction - disturbance) / (plane.inertia + a[1])
        return np.concatenate([[w, dw, dtau, ddtau], dmu, v, ((u - c * v) / m)[di]])

    def load(states: Array) -> tuple[Array, Array]:
        p = states[9 : 9 + count]
        return g * m @ p, m @ p**2

    p0 = np.array([a.position for a in scenario.agents])
    v0 = np.array([a.velocity for a in scenario.agents])[di]
    raw = law(0.0, plane.angle, plane.angular_velocity, np.zeros(5))[0]
    tau0 = np.clip(raw, -curve.torque_max, curve.torque_max)
    start = np.concatenate([[plane.angle, plane.angular_velocity, tau0, 0.0], np.zeros(5), p0, v0])
    return rhs, start, load


def solve(scenario: Scenario, *, rtol: float = 1e-8, atol: float = 1e-10) -> Solution:
    """Solve the closed loop of a scenario with a `pd` or `arise` controller and without faults or limits."""
    rhs, start, load = _closed_loop(scenario)
    time = np.arange(scenario.steps + 1) * scenario.period
    found = solve_ivp(rhs, (0.0, time[-1]), start, "LSODA", t_eval=time, rtol=rtol, atol=atol, max_step=0.5)
    assert found.success, found.message
    torque, inertia = load(found.y)
    return Solution(time, found.y[0], torque, inertia)
