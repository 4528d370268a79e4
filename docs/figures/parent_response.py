"""Measure and draw docs/explanation/parent_response.md: python docs/figures/parent_response.py [PICTURE]."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from swarmabs_bag.shown.colours import ERROR, REFERENCE, TORQUE
from swarmabs_config.scenarios import as_override, find_scenario
from swarmabs_run.simulation import simulate

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.arrays import RunArrays

    Array = NDArray[np.float64]

PICTURE = Path(__file__).parents[1] / "images" / "parent_response.png"
NOISE = {"plane.sensor.noise": [1e-4, 1e-3]}
SIGMA = 1e-4
"""Noise of the angular velocity assumed for the estimate of the inertia, rad/s."""


def watched(name: str, overrides: Mapping[str, object]) -> tuple[Scenario, RunArrays]:
    """Simulate 30 s of a scenario whose observer uses the plane's motion."""
    changed = {"duration": 30.0, "observer.type": "parent_response", **overrides}
    scenario = find_scenario(name, [as_override(path, value) for path, value in changed.items()])
    return scenario, simulate(scenario)


def chosen(bandwidth: int | str) -> dict[str, object]:
    """Return the overrides that select an observer by its bandwidth (rad/s), or the sum."""
    return {"observer.type": "sum"} if bandwidth == "sum" else {"observer.bandwidth": bandwidth}


def true_torques(scenario: Scenario, run: RunArrays) -> tuple[Array, Array]:
    """Return the torque of the robots' weight, and its sum with the indistinguishable part of the disturbance, N m."""
    weight = scenario.plane.gravity * (run.agents.position @ np.array([agent.mass for agent in scenario.agents]))
    disturbance = scenario.plane.disturbance
    unknown = disturbance.amplitude * np.sin(disturbance.angular_frequency * run.time)
    return weight, weight + unknown / np.cos(run.angle)


def torque_table() -> None:
    """Print the accuracy of the torque estimate, and its effect on the plane."""
    show("scenario", "observer", "noise", "rms, 0.5-5 s", "rms, after 5 s", "max, after 5 s", "angle error after 5 s")
    for name in ("pd_si_4", "arise_si_4", "pd_di_4", "arise_di_4"):
        for noise, bandwidths in (({}, (20, 50, 200)), (NOISE, (5, 10, 20, 50))):
            for bandwidth in ("sum", *bandwidths):
                scenario, run = watched(name, {**noise, **chosen(bandwidth)})
                error = run.abstract.torque - true_torques(scenario, run)[1]
                early, late = (run.time >= 0.5) & (run.time < 5.0), run.time >= 5.0
                angle = np.abs(run.reference - run.angle)[late].max()
                figures = (rms(error[early]), rms(error[late]), np.abs(error[late]).max(), angle)
                show(name, str(bandwidth), "yes" if noise else "no", *(f"{figure:.1e}" for figure in figures))


WINDOWS = ((0.01, 0.0, 0.5, 1), (0.01, 0.5, 1.5, 1), (0.01, 5.0, 6.0, 1), (0.01, 10.0, 20.0, 1), (0.001, 0.0, 0.1, 4))
"""Control period, s; begin and end of a window, s; degree of the polynomial that models the torque."""


def inertia_table() -> None:
    """Print the least-squares estimates of J_s from the plane's motion, with their standard deviation."""
    show("scenario", "period", "window", "largest w'", "true J_s", "degree", "estimate", "spread", "condition")
    for name in ("pd_si_4", "arise_si_4"):
        for period, begin, end, degree in WINDOWS:
            scenario, run = watched(name, {"step": period, "duration": end})
            rows = slice(round(begin / period), None)
            estimate, spread, condition = inertia(scenario, run.angle[rows], run.angular_velocity[rows], degree)
            fastest = np.abs(np.diff(run.angular_velocity[rows])).max() / period
            show(
                *(name, f"{period:g}", f"{begin:g} to {end:g}", f"{fastest:.1e}"),
                *(f"{run.abstract.inertia[rows].mean():.3f}", f"{degree}"),
                *(f"{estimate:.2g}", f"{spread:.1g}", f"{condition:.0e}"),
            )


def inertia(scenario: Scenario, angle: Array, rate: Array, degree: int) -> tuple[float, float, float]:
    """Fit J_s, and a torque polynomial in time, to the plane's momentum in a window.

    ``J w + integral of f = c - J_s w - sum over n of tau_n (integral of t^n cos th)`` is linear in all unknowns.

    Returns
    -------
    tuple of float
        J_s in kg m^2; its standard deviation if w has white noise of `SIGMA`; condition number of the scaled columns.
    """
    period, friction = scenario.period, scenario.plane.friction
    time = np.linspace(-1.0, 1.0, len(angle))
    drag = np.array([friction.torque(w) for w in rate])

    def integral(values: Array) -> Array:
        return np.concatenate([[0.0], np.cumsum(0.5 * period * (values[1:] + values[:-1]))])

    torques = [-integral(time**n * np.cos(angle)) for n in range(degree + 1)]
    columns = np.stack([-rate, np.ones_like(rate), *torques], axis=1)
    found = np.linalg.lstsq(columns, scenario.plane.inertia * rate + integral(drag), rcond=None)[0]
    spread = SIGMA * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0])
    scaled = columns / np.linalg.norm(columns, axis=0)
    return (
        float(found[0]),
        float((scenario.plane.inertia + scenario.manifold.offset) * spread),
        float(np.linalg.cond(scaled)),
    )


def show(*cells: str) -> None:
    """Write a row of a table in Markdown."""
    sys.stdout.write(f"| {' | '.join(cells)} |\n")


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def draw(picture: Path) -> None:
    """Draw torque and angle error of `arise_si_4` with both observers."""
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    torque, error = figure.subplots(2, 1, sharex=True)
    scenario, run = watched("arise_si_4", {"observer.bandwidth": 20, **NOISE})
    weight, seen = true_torques(scenario, run)
    torque.plot(run.time, run.abstract.torque, color=ERROR, linewidth=0.6, label="estimate of the disturbance observer")
    torque.plot(
        run.time, seen, color=REFERENCE, linewidth=1.4, linestyle=(0, (4, 2)), label=r"$\tau_s + \tau_d/\cos\theta$"
    )
    torque.plot(run.time, weight, color=TORQUE, linewidth=1.4, label=r"$\tau_s$, weight of the robots")
    torque.set_ylabel("torque, N m")
    _, summed = watched("arise_si_4", {**chosen("sum"), **NOISE})
    pairs = ((summed, "sum over the robots", TORQUE), (run, "disturbance observer", ERROR))
    for found, label, colour in pairs:
        error.plot(found.time, 1e3 * (found.reference - found.angle), color=colour, linewidth=1.2, label=label)
    error.set(xlabel="time, s", ylabel=r"$\theta_d - \theta$, mrad", ylim=(-6.0, 6.0), xlim=(0.0, 30.0))
    for axes in (torque, error):
        axes.legend(loc="upper right", fontsize=8, ncols=3)
        axes.grid(linewidth=0.4)
    torque.set_ylim(-0.3, 0.45)
    figure.savefig(picture, dpi=150, metadata={"Software": None})


if __name__ == "__main__":
    torque_table()
    inertia_table()
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE)
