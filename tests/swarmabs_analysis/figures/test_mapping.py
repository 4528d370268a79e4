"""The figures of the abstract space show its geometry, computed anew from the definitions."""

import itertools
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray
from scipy.optimize import brentq

from swarmabs_analysis.figures.abstract_space import draw_mapping_example, draw_position_mapping
from swarmabs_analysis.figures.style import styled

Floats = NDArray[np.float64]
GRAVITY = 9.81
MASSES = np.array([0.3552, 0.3532, 0.6762, 0.4596])
HALF = 0.5


@pytest.fixture(scope="module")
def mapping() -> Axes:
    with styled():
        (axes,) = draw_position_mapping().axes
    return axes


class Facets(Poly3DCollection):  # type: ignore[misc]
    """Facets that keep the corners which they were made of."""

    def __init__(self, corners: Floats, **options: Any) -> None:
        super().__init__(corners, **options)
        self.corners = corners


def abstract(positions: Floats) -> Floats:
    """Return torque and inertia, (..., 2), of positions of the paper's four robots, (..., 4)."""
    return np.stack([GRAVITY * (MASSES * positions).sum(axis=-1), (MASSES * positions**2).sum(axis=-1)], axis=-1)


def lines(axes: Axes, colour_of: str) -> list[Floats]:
    """Return the points of all lines that look like the one of this label."""
    (named,) = [line for line in axes.lines if str(line.get_label()).startswith(colour_of)]
    same = (named.get_color(), named.get_linestyle(), named.get_linewidth())
    alike = [line for line in axes.lines if (line.get_color(), line.get_linestyle(), line.get_linewidth()) == same]
    return [np.asarray(line.get_xydata(), dtype=float) for line in alike]


def test_all_vertices_and_32_edges_of_the_box_are_drawn(mapping: Axes) -> None:
    (points,) = lines(mapping, "vertex")
    corners = abstract(HALF * np.array(list(itertools.product((-1.0, 1.0), repeat=4))))
    apart = np.abs(points[:, None] - corners).max(axis=2)
    assert apart.min(axis=0).max() < 1e-9 > apart.min(axis=1).max()
    drawn = lines(mapping, "edge")
    middles = [edge[len(edge) // 2] for edge in drawn]
    for moving in range(4):
        for signs in itertools.product((-HALF, HALF), repeat=3):
            positions = np.insert(np.array(signs), moving, 0.0)
            nearest = int(np.argmin([np.abs(middle - abstract(positions)).max() for middle in middles]))
            walk = np.repeat(positions[None, :], len(drawn[nearest]), axis=0)
            walk[:, moving] = np.linspace(-HALF, HALF, len(walk))
            np.testing.assert_allclose(drawn[nearest], abstract(walk), atol=1e-12)
    assert len(drawn) == 4 * 2**3


def largest_position(torque: float, inertia: float) -> float:
    """Return the largest |p_i| over all positions with this torque and inertia, by Lagrange's condition."""
    scale = np.sqrt(MASSES)
    normal = scale / np.sqrt(MASSES.sum())
    centre = torque / GRAVITY / np.sqrt(MASSES.sum()) * normal
    free = np.sqrt(max(inertia - centre @ centre, 0.0))
    across = np.eye(4) - np.outer(normal, normal)
    return max(abs(centre[i]) / scale[i] + free * np.sqrt(across[i, i]) / scale[i] for i in range(4))


def test_lower_bound_is_the_least_inertia_and_the_upper_where_a_robot_can_just_reach_the_end(mapping: Axes) -> None:
    (points,) = lines(mapping, "lower bound")
    scale = np.sqrt(MASSES)
    for torque, inertia in points:
        scaled, *_ = np.linalg.lstsq((GRAVITY * scale)[None, :], [torque])  # of least norm
        assert inertia == pytest.approx(float(scaled @ scaled), abs=1e-12)
    (points,) = lines(mapping, "upper boundary")
    for torque, inertia in points[5:-5:10]:
        assert largest_position(torque, inertia) == pytest.approx(HALF, abs=1e-9)


def test_random_states_are_coloured_by_their_class(mapping: Axes) -> None:
    clouds = {
        str(cloud.get_label())[-3:]: np.asarray(cloud.get_offsets())
        for cloud in mapping.collections
        if isinstance(cloud, PathCollection)
    }
    assert clouds.keys() == {"A_A", "A_P", "A_U"}
    for name, points in clouds.items():
        assert len(points) > 50
        for torque, inertia in points:
            farthest, highest = largest_position(torque, inertia), envelope(torque)
            assert farthest <= HALF + 1e-9 if name == "A_A" else farthest > HALF - 1e-9
            assert name == "A_A" or (inertia <= highest + 1e-9 if name == "A_P" else inertia > highest - 1e-9)


def envelope(torque: float) -> float:
    """Return the largest inertia at a torque on the box: one robot is free, the others stand at an end."""
    inertias = [-np.inf]
    for moving in range(4):
        others = np.delete(MASSES, moving)
        for signs in itertools.product((-HALF, HALF), repeat=3):
            position = (torque / GRAVITY - others @ np.array(signs)) / MASSES[moving]
            if abs(position) <= HALF + 1e-12:
                inertias.append(float(MASSES[moving] * position**2 + others.sum() * HALF**2))
    return max(inertias)


def test_manifold_and_where_it_leaves_the_admissible_set(mapping: Axes) -> None:
    (curve,) = lines(mapping, "manifold")
    np.testing.assert_allclose(curve[:, 1], 0.0125 * curve[:, 0] ** 2 + 0.025, rtol=1e-12)
    assert (curve[0, 0], curve[-1, 0]) == (-5.0, 5.0)
    leaves = brentq(lambda t: largest_position(t, 0.0125 * t * t + 0.025) - HALF, 0.1, 5.0)
    assert leaves == pytest.approx(2.288, abs=5e-4)
    (line,) = [line for line in mapping.lines if "leaves" in str(line.get_label())]
    np.testing.assert_allclose(line.get_xdata(), [-leaves, leaves], atol=1e-9)
    np.testing.assert_allclose(line.get_ydata(), 0.0125 * leaves**2 + 0.025, atol=1e-9)
    assert "2.288 N m" in str(line.get_label())


def test_ellipse_plane_and_ellipsoid_of_the_example(monkeypatch: pytest.MonkeyPatch) -> None:
    masses = np.array([2.0, 3.0, 3.0])
    monkeypatch.setattr("swarmabs_analysis.figures.abstract_space.Poly3DCollection", Facets)
    with styled():
        (axes,) = draw_mapping_example().axes
    for line in axes.lines:
        points = np.transpose(line.get_data_3d())  # type: ignore[attr-defined]
        np.testing.assert_allclose(GRAVITY * points @ masses, 10.0, rtol=1e-12)
        np.testing.assert_allclose(points**2 @ masses, 1.0, rtol=1e-12)
        np.testing.assert_allclose(points[0], points[-1], atol=1e-12)
        # It goes all around: farthest from each side as Lagrange's condition says.
        centre = 10.0 / GRAVITY / masses.sum()
        reach = np.sqrt((1.0 - masses.sum() * centre**2) * (1.0 / masses - 1.0 / masses.sum()))
        np.testing.assert_allclose(points.max(axis=0), centre + reach, rtol=1e-3)
        np.testing.assert_allclose(points.min(axis=0), centre - reach, rtol=1e-3)
    (facets,) = [collection for collection in axes.collections if isinstance(collection, Facets)]
    corners = facets.corners
    torque, inertia = GRAVITY * corners @ masses, corners**2 @ masses
    on_plane = (np.abs(torque - 10.0) < 1e-9).all(axis=1)
    on_ellipsoid = (np.abs(inertia - 1.0) < 1e-9).all(axis=1)
    assert (on_plane | on_ellipsoid).all() and on_plane.sum() > 100 and on_ellipsoid.sum() > 100
    # The ellipsoid is whole, and no facet of one crosses the other, so that each hides what is behind it.
    np.testing.assert_allclose(corners[on_ellipsoid].max(axis=(0, 1)), 1.0 / np.sqrt(masses), rtol=5e-3)
    for beyond in (torque[on_ellipsoid] - 10.0, inertia[on_plane] - 1.0):
        assert ((beyond >= -1e-9).all(axis=1) | (beyond <= 1e-9).all(axis=1)).all()
    labels = [axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()]  # type: ignore[attr-defined]
    assert labels == ["p₁, m", "p₂, m", "p₃, m"]
