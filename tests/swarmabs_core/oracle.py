"""The closed loop in continuous time, written from the equations alone and solved by SciPy.

It shares nothing with the package but the scenario's numbers: neither its functions nor its sampled form.
Single integrators have their velocity at once, the command filter sees tau_raw continuously, and sgn(e2) is
tanh(e2/smoothing).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from swarmabs_config.scenario import Scenario

Array = NDArray[np.float64]
Law = Callable[[float, float, float, Array], tuple[float, Array]]
"""Time, angle, rate and the law's own state (mu1, mu2) in; tau_raw and the rate of the state out."""
FILTER_BANDWIDTH = 50.0


class Solution(NamedTuple):
    """Angle (rad), torque (N m) and inertia (kg m^2) of the swarm at the steps of the scenario."""

    time: Array
    angle: Array
    torque: Array
    inertia: Array


def _arise(c: dict[str, Any], scenario: Scenario) -> Law:
    """ARISE on the sine trajectory."""
    slopes = np.array([scenario.plane.friction[i] for i in (1, 2, 4)])
    gamma, start, ks1 = np.array(c["gamma"]), np.array(c["adaptive_initial"]), c["ks"] + 1
    a, f = c["trajectory"]["amplitude"], c["trajectory"]["angular_frequency"]

    def errors(t: float, th: float, w: float) -> tuple[float, Array, Array, Array]:
        """Return e2, Y_d, Y_d' and Y_d''."""
        th_d, w_d, dw, ddw, dddw = (a * f**n * np.sin(f * t + n * np.pi / 2) for n in range(5))
        y = np.tanh(slopes * w_d)
        s = np.cosh(np.clip(slopes * w_d, -300, 300)) ** -2
        dy, ddy = slopes * dw * s, slopes * ddw * s - 2 * (slopes * dw) ** 2 * s * y
        columns = ((dw, y, w_d), (ddw, dy, dw), (dddw, ddy, ddw))
        regressor = (np.array([first, q[0] - q[1], q[2], last]) for first, q, last in columns)
        return w_d - w + c["alpha1"] * (th_d - th), *regressor

    e2_0, _, dy_0, _ = errors(0.0, scenario.plane.angle, scenario.plane.angular_velocity)

    def law(t: float, th: float, w: float, mu: Array) -> tuple[float, Array]:
        e2, y, dy, ddy = errors(t, th, w)
        estimate = start + gamma * (dy * e2 - dy_0 * e2_0 - mu[1:])
        dmu1 = ks1 * c["alpha2"] * e2 + c["beta"] * np.tanh(e2 / c["smoothing"])
        tau = -(y @ estimate + ks1 * (e2 - e2_0) + mu[0]) / np.cos(th)
        return tau, np.concatenate([[dmu1], (ddy - c["alpha2"] * dy) * e2])

    return law


def _law(scenario: Scenario) -> Law:
    settings = scenario.controller.model_dump(by_alias=True)
    if scenario.controller.type == "arise":
        return _arise(settings, scenario)
    k1, k2 = settings["gains"]
    return lambda _, th, w, mu: (k1 * th + k2 * w, 0.0 * mu)


def solve(scenario: Scenario, *, rtol: float = 1e-8, atol: float = 1e-10) -> Solution:
    """Solve the closed loop of a scenario with a `pd` or `arise` controller and without faults or limits."""
    plane, gains, curve, law = scenario.plane, scenario.swarm.gains, scenario.manifold, _law(scenario)
    g, (g1, g2, g3, g4, g5, g6) = plane.gravity, plane.friction
    m, c, p0, v0 = np.array([(a.mass, a.damping, a.position, a.velocity) for a in scenario.agents]).T
    di = np.array([a.kind == "double_integrator" for a in scenario.agents])
    count, k, kp, kd, ksd = len(m), np.array(gains.k), np.array(gains.kp), np.array(gains.kd), gains.ksd
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

    raw = law(0.0, plane.angle, plane.angular_velocity, np.zeros(5))[0]
    tau0 = np.clip(raw, -curve.torque_max, curve.torque_max)
    start = np.concatenate([[plane.angle, plane.angular_velocity, tau0, 0.0], np.zeros(5), p0, v0[di]])
    time = np.arange(scenario.steps + 1) * scenario.period
    found = solve_ivp(rhs, (0.0, time[-1]), start, "LSODA", t_eval=time, rtol=rtol, atol=atol, max_step=0.5)
    assert found.success, found.message
    p = found.y[9 : 9 + count]
    return Solution(time, found.y[0], g * m @ p, m @ p**2)
