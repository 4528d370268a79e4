"""The cascade in continuous time, written from docs/cascade.md and the equations alone and solved by SciPy.

It shares with the example the numbers of the scenario files only. It is idealised: no sampling and no delay of a
period; every lower swarm exerts at once the torque and inertia that its controller asks for after the command filter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml
from scipy.integrate import solve_ivp

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

# The defaults of docs/design.md, and the command filter of docs/equations.md.
GRAVITY, INERTIA, CURVATURE, OFFSET, FILTER = 9.81, 0.5, 0.0125, 0.025, 50.0


def friction(w: Any) -> Any:
    return 0.01 * (np.tanh(1000.0 * w) - np.tanh(700.0 * w)) + 0.02 * np.tanh(1000.0 * w) + w


class Solution(NamedTuple):
    """Angles of the upper plane (n,) and of the lower ones (n, N), positions of the upper robots (n, N)."""

    upper: Array
    lower: Array
    position: Array


def solve(folder: Path, ratio: float, bandwidth: float, time: Array) -> Solution:
    """Solve the scenarios of a folder at times in s."""

    def read(name: str) -> dict[str, Any]:
        loaded: dict[str, Any] = yaml.safe_load((folder / f"{name}.yaml").read_text(encoding="utf-8"))
        return loaded

    above = read("upper")
    robots = above["swarm"]["agents"]
    n = len(robots)
    below = [read(f"lower_{robot['id']}") for robot in robots]
    mass = np.array([robot["mass"] for robot in robots])
    k1, k2 = above["controller"]["gains"]
    gain, fastest = np.array(above["swarm"]["gains"]["k"]), above["limits"]["velocity"]
    lower_gains = np.array([scenario["controller"]["gains"] for scenario in below])
    tilts = np.array([scenario["plane"]["angle"] for scenario in below])
    angle = above["plane"]["angle"]

    def rates(_: float, state: Array) -> Array:
        th, w, tau, dtau = state[:4]
        p, s, r, dr, x, dx, a, v = state[4:].reshape(8, n)
        # The robots' law, with the pseudo-inverse of the matrix that maps velocities to rates of the abstract state.
        phi = np.vstack([GRAVITY * mass, 2.0 * mass * p])
        wanted = np.array([tau, CURVATURE * tau**2 + OFFSET])
        there = np.array([GRAVITY * mass @ p, mass @ p**2])
        ahead = np.array([dtau, 2.0 * CURVATURE * tau * dtau])
        u = np.clip(np.linalg.pinv(phi) @ (gain * (wanted - there) + ahead), -fastest, fastest)
        # The reference of every lower plane: three equal lags.
        ds = bandwidth * (u / ratio - s)
        ddr = bandwidth**2 * (s - r) - 2.0 * bandwidth * dr
        raw = lower_gains[:, 0] * (a - r) + lower_gains[:, 1] * (v - dr)
        raw -= ((INERTIA + OFFSET) * ddr + friction(dr)) / np.cos(a)
        ddx = FILTER**2 * (np.clip(raw, -5.0, 5.0) - x) - 2.0 * FILTER * dx
        dv = (-np.cos(a) * x - 2.0 * CURVATURE * x * dx * v - friction(v)) / (INERTIA + CURVATURE * x**2 + OFFSET)
        # The upper plane under its robots, which move as the lower planes are tilted.
        dp = ratio * a
        dw = (-np.cos(th) * there[0] - 2.0 * (mass * p) @ dp * w - friction(w)) / (INERTIA + there[1])
        ddtau = FILTER**2 * (np.clip(k1 * th + k2 * w, -5.0, 5.0) - tau) - 2.0 * FILTER * dtau
        return np.concatenate([[w, dw, dtau, ddtau], dp, ds, dr, ddr, dx, ddx, v, dv])

    zero = np.zeros(n)
    places = np.array([robot["position"] for robot in robots])
    initial = np.concatenate([[angle, 0.0, k1 * angle, 0.0], places, tilts, tilts, zero, zero, zero, tilts, zero])
    found = solve_ivp(rates, (time[0], time[-1]), initial, method="LSODA", t_eval=time, rtol=1e-7, atol=1e-9)
    assert found.success, found.message
    planes = found.y[4:].reshape(8, n, -1)
    return Solution(found.y[0], planes[6].T, planes[0].T)
