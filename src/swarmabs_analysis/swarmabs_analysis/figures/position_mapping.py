"""The abstract space of the paper's four robots and the sets within: fig. posMapping."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from swarmabs_analysis.figures.constraint_samples import abstract_states, box_positions, classify_points
from swarmabs_analysis.figures.style import BLACK, BLUE, COLUMN, DASHED, GREEN, GREY, PURPLE, SKY, SOLID, VERMILION
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass, box_edges

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from swarmabs_core.manifold import Manifold

    Floats = NDArray[np.float64]

SCENARIO = "pd_het_4"
"""Whose robots, plane and manifold are shown; the other runs of four robots have the same."""
SPREADS = (0.5, 1.0, 1.5)
"""Widths, over that of the plane, within which the random positions are drawn; only the last leaves the plane."""
SAMPLES = 500
"""Random positions for each width."""
LOOKS = {
    StateClass.ADMISSIBLE: (BLUE, "o", 2.5),
    StateClass.PARTIAL: (VERMILION, "x", 5.0),
    StateClass.UNREACHABLE: (GREY, "+", 6.0),
}
_FINE = 400


def draw_position_mapping() -> Figure:
    """Draw how the box of positions maps into the abstract space, and where the manifold leaves A_A."""
    scenario = find_scenario(SCENARIO)
    swarm = ConstraintSets(
        tuple(agent.mass for agent in scenario.agents), scenario.plane.length, scenario.plane.gravity
    )
    figure = Figure(figsize=(COLUMN, 3.5), layout="constrained")
    axes = figure.add_subplot()
    _samples(axes, swarm)
    _box(axes, swarm)
    _boundaries(axes, swarm)
    _manifold(axes, swarm, scenario.manifold)
    corner = sum(swarm.masses) * swarm.length**2 / 4.0
    axes.set(
        xlabel="torque τₛ, N m",
        ylabel="inertia Jₛ, kg m²",
        xlim=(-1.06 * swarm.largest_torque, 1.06 * swarm.largest_torque),
        ylim=(0.0, 1.15 * corner),
    )
    figure.legend(loc="outside upper center", ncols=2, markerscale=1.4)
    return figure


def edge_curves(swarm: ConstraintSets) -> Iterator[tuple[Floats, Floats]]:
    """Yield torque (N m) and inertia (kg m^2) along each edge of the box |p_i| <= L/2."""
    half, total = swarm.length / 2.0, sum(swarm.masses)
    x = np.linspace(-1.0, 1.0, 61)
    for edge in box_edges(swarm.masses):
        yield swarm.gravity * half * (edge.rest + edge.mass * x), half**2 * (total - edge.mass * (1.0 - x * x))


def samples(swarm: ConstraintSets) -> tuple[Floats, Floats]:
    """Return torques (N m) and inertias (kg m^2) of random positions, uniform within each width."""
    drawn = [box_positions(swarm.masses, spread * swarm.length, SAMPLES, seed) for seed, spread in enumerate(SPREADS)]
    return abstract_states(np.concatenate(drawn), swarm.masses, swarm.gravity)


def _samples(axes: Axes, swarm: ConstraintSets) -> None:
    torque, inertia = samples(swarm)
    classes = classify_points(torque, inertia, swarm)
    for kind, (colour, marker, size) in LOOKS.items():
        chosen = classes == kind
        axes.scatter(
            torque[chosen],
            inertia[chosen],
            s=size,
            marker=marker,
            color=colour,
            linewidths=0.5 if marker != "o" else 0.0,
            label=f"random state in {kind.value}",
        )


def _box(axes: Axes, swarm: ConstraintSets) -> None:
    ends = []
    for number, (torque, inertia) in enumerate(edge_curves(swarm)):
        axes.plot(torque, inertia, color=PURPLE, linewidth=0.6, label="" if number else "edge of the hypercube")
        ends += [(torque[0], inertia[0]), (torque[-1], inertia[-1])]
    axes.plot(
        *np.unique(np.round(ends, 12), axis=0).T,
        linestyle="none",
        marker="s",
        markersize=3.0,
        color=PURPLE,
        markeredgecolor=BLACK,
        markeredgewidth=0.4,
        label="vertex of the hypercube",
    )


def _boundaries(axes: Axes, swarm: ConstraintSets) -> None:
    torque = np.linspace(-swarm.largest_torque, swarm.largest_torque, _FINE + 1)
    least = [swarm.smallest_inertia(t) for t in torque.tolist()]
    inner = [swarm.largest_admissible_inertia(t) for t in torque.tolist()]
    axes.plot(torque, least, color=SKY, linestyle=SOLID, linewidth=1.8, label="lower bound")
    axes.plot(torque, inner, color=BLACK, linestyle=DASHED, linewidth=1.0, label="upper boundary of A_A")


def _manifold(axes: Axes, swarm: ConstraintSets, manifold: Manifold) -> None:
    torque = np.linspace(-manifold.torque_max, manifold.torque_max, _FINE + 1)
    inertia = [manifold.inertia(t) for t in torque.tolist()]
    axes.plot(torque, inertia, color=GREEN, linewidth=2.2, label="manifold A_c")
    reach = swarm.manifold_reach(manifold.curvature, manifold.offset)
    leaves = reach.admissible
    axes.plot(
        [-leaves, leaves],
        [manifold.inertia(leaves)] * 2,
        linestyle="none",
        marker="D",
        markersize=4.5,
        color="white",
        markeredgecolor=BLACK,
        label=f"A_c leaves A_A: |τ| = {leaves:.3f} N m",
    )
