"""The geometry of the abstraction: fig. mappingEx, the preimage of an abstract state, and fig. posMapping.

The latter shows the abstract space of the paper's four robots and its constraint sets.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from swarmabs_analysis.figures.style import (
    BLACK,
    BLUE,
    COLUMN,
    DASHED,
    GREEN,
    GREY,
    PURPLE,
    SKY,
    SOLID,
    VERMILION,
    YELLOW,
)
from swarmabs_config.scenarios import load_builtin
from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass, box_edges

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from mpl_toolkits.mplot3d import Axes3D
    from numpy.typing import NDArray

    from swarmabs_core.manifold import Manifold

    Floats = NDArray[np.float64]

EXAMPLE = ((2.0, 3.0, 3.0), 10.0, 1.0, 9.81)
"""Masses (kg) of three robots, torque (N m), inertia (kg m^2) and gravity (m/s^2) of fig. mappingEx."""
_VIEW = (24.0, -14.0)
"""Elevation and azimuth of the viewpoint, degrees."""
_LIGHT = np.array([0.3, -0.6, 0.75])
_EXTENT = 1.08
"""Half of the plane's side over the sphere's radius, in coordinates where the ellipsoid is a sphere."""

SCENARIO = "pd_het_4"
"""The scenario whose robots, plane and manifold are shown; the other runs with four robots have the same."""
SPREADS = (0.5, 1.0, 1.5)
"""Ranges of the random positions over the length of the plane; only the last exceeds the plane."""
SAMPLES = 500
"""Random positions per range."""
LOOKS = {
    StateClass.ADMISSIBLE: (BLUE, "o", 2.5),
    StateClass.PARTIAL: (VERMILION, "x", 5.0),
    StateClass.UNREACHABLE: (GREY, "+", 6.0),
}
_FINE = 400


class Preimage(NamedTuple):
    """The preimage of an abstract state of three robots: a circle, in coordinates where the ellipsoid is a sphere.

    With q_i = sqrt(m_i) p_i the ellipsoid sum m p^2 = J is a sphere of radius sqrt(J), and g sum m p = tau a plane at
    the distance T/sqrt(M) along the normal sqrt(m_i/M), for T = tau/g and M = sum m.
    """

    scale: Floats  # sqrt(m_i), (3,), sqrt(kg)
    radius: float  # of the sphere, sqrt(kg) m
    distance: float  # of the plane from the origin, sqrt(kg) m
    axes: Floats  # two directions in the plane and its normal, (3, 3), a row each

    @property
    def circle(self) -> float:
        """Radius of the circle, sqrt(kg) m."""
        return float(np.sqrt(self.radius**2 - self.distance**2))

    def positions(self, along: Floats, across: Floats, height: Floats | float) -> Floats:
        """Return positions (m), (..., 3), from coordinates in the plane and along its normal, sqrt(kg) m."""
        points = np.stack(np.broadcast_arrays(along, across, height), axis=-1)
        return (points[..., None] * self.axes).sum(axis=-2) / self.scale


def preimage(masses: tuple[float, float, float], torque: float, inertia: float, gravity: float) -> Preimage:
    """Return the preimage of an abstract state (N m, kg m^2) of three robots with these masses (kg)."""
    scale = np.sqrt(masses)
    total = sum(masses)
    normal = scale / np.sqrt(total)
    first = np.cross(normal, [0.0, 0.0, 1.0])
    first /= np.sqrt((first**2).sum())
    directions = np.array([first, np.cross(normal, first), normal])
    return Preimage(scale, float(np.sqrt(inertia)), torque / gravity / float(np.sqrt(total)), directions)


def ellipse(example: Preimage, count: int = 241) -> Floats:
    """Return points (m) of the preimage, (count, 3), closed: the last point equals the first."""
    turn = np.linspace(0.0, 2.0 * np.pi, count)
    return example.positions(example.circle * np.cos(turn), example.circle * np.sin(turn), example.distance)


def draw_mapping_example() -> Figure:
    """Draw plane, ellipsoid and preimage for the numbers of the paper."""
    _, torque, inertia, _ = EXAMPLE
    example = preimage(*EXAMPLE)
    figure = Figure(figsize=(COLUMN, 3.3))
    axes: Axes3D = figure.add_axes((0.0, 0.04, 0.94, 0.98), projection="3d", computed_zorder=False)
    axes.view_init(*_VIEW)
    sphere, plane = _sphere(example), _plane(example)
    # One collection, so that facets of plane and ellipsoid hide each other by their depth.
    facets = Poly3DCollection(
        np.concatenate([sphere, plane]),
        facecolors=np.concatenate([_shaded(sphere, VERMILION, 0.65), _shaded(plane, SKY, 0.85)]),
        edgecolors="none",
        zorder=1,
    )
    axes.add_collection3d(facets)
    axes.plot(*ellipse(example).T, color=BLACK, linewidth=2.6, zorder=2)
    axes.plot(*ellipse(example).T, color=YELLOW, linewidth=1.4, zorder=3)
    limit = float(np.abs(plane).max())
    axes.set(xlim=(-limit, limit), ylim=(-limit, limit), zlim=(-limit, limit))
    axes.set_box_aspect((1.0, 1.0, 1.0), zoom=1.0)
    for name, axis in (("p₁", axes.xaxis), ("p₂", axes.yaxis), ("p₃", axes.zaxis)):
        axis.set_label_text(f"{name}, m")
        axis.set_major_locator(MaxNLocator(5, prune="both"))
        axis.labelpad = -3.0
        axis.set_tick_params(pad=-1.0)
    handles = [
        Patch(facecolor=SKY, label=f"τₛ = {torque:g} N m"),
        Patch(facecolor=VERMILION, label=f"Jₛ = {inertia:g} kg m²"),
        Line2D(
            [],
            [],
            color=YELLOW,
            linewidth=1.4,
            path_effects=[Stroke(linewidth=2.6, foreground=BLACK), Normal()],
            label="preimage of both",
        ),
    ]
    figure.legend(handles=handles, loc="upper center", ncols=3)
    return figure


def _sphere(example: Preimage) -> Floats:
    """Return facets of the ellipsoid, (K, 4, 3), none of which crosses the plane."""
    cut = np.arccos(example.distance / example.radius)
    polar = np.concatenate([np.linspace(0.0, cut, 13)[:-1], np.linspace(cut, np.pi, 25)])[:, None]
    turn = np.linspace(0.0, 2.0 * np.pi, 65)
    ring = example.radius * np.sin(polar)
    return _facets(example.positions(ring * np.cos(turn), ring * np.sin(turn), example.radius * np.cos(polar)))


def _plane(example: Preimage) -> Floats:
    """Return facets of the plane, (K, 4, 3), none of which crosses the ellipsoid."""
    turn = np.linspace(0.0, 2.0 * np.pi, 65)
    rim = _EXTENT * example.radius / np.maximum(np.abs(np.cos(turn)), np.abs(np.sin(turn)))
    inner, outer = np.linspace(0.0, 1.0, 11)[:-1, None], np.linspace(0.0, 1.0, 11)[:, None]
    away = np.concatenate([inner * example.circle + 0.0 * turn, example.circle + outer * (rim - example.circle)])
    return _facets(example.positions(away * np.cos(turn), away * np.sin(turn), example.distance))


def _facets(grid: Floats) -> Floats:
    corners = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)
    return corners.reshape(-1, 4, 3)


def _shaded(facets: Floats, colour: str, opacity: float) -> Floats:
    """Return the colours of the lit facets, (K, 4)."""
    normals = np.cross(facets[:, 2] - facets[:, 0], facets[:, 3] - facets[:, 1])
    normals /= np.sqrt((normals**2).sum(axis=1, keepdims=True))
    bright = 0.7 + 0.3 * np.abs((normals * _LIGHT).sum(axis=1))
    return np.column_stack([bright[:, None] * np.array(to_rgb(colour)), np.full(len(facets), opacity)])


def draw_position_mapping() -> Figure:
    """Draw how the box of positions maps into the abstract space, and where the manifold leaves A_A."""
    scenario = load_builtin(SCENARIO)
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


def random_states(swarm: ConstraintSets) -> tuple[Floats, Floats]:
    """Return torques (N m) and inertias (kg m^2) of random positions, uniform within each range."""
    masses, count = np.asarray(swarm.masses), (SAMPLES, len(swarm.masses))
    ends = [spread * swarm.length / 2 for spread in SPREADS]
    drawn = [np.random.default_rng(seed).uniform(-end, end, count) for seed, end in enumerate(ends)]
    positions = np.concatenate(drawn)
    return swarm.gravity * (positions * masses).sum(axis=1), (positions**2 * masses).sum(axis=1)


def _samples(axes: Axes, swarm: ConstraintSets) -> None:
    torque, inertia = random_states(swarm)
    classes = np.array([swarm.classify(*state) for state in zip(torque.tolist(), inertia.tolist(), strict=True)])
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
    half, total = swarm.length / 2.0, sum(swarm.masses)
    x = np.linspace(-1.0, 1.0, 61)
    ends = []
    for number, edge in enumerate(box_edges(swarm.masses)):
        torque = swarm.gravity * half * (edge.rest + edge.mass * x)
        inertia = half**2 * (total - edge.mass * (1.0 - x * x))
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
    leaves = swarm.admissible_reach(manifold.curvature, manifold.offset)
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
