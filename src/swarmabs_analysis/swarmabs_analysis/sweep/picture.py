"""The picture of a sweep: the outcomes of the cases over two parameters."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from swarmabs_analysis.sweep.evaluate import OUTCOMES
from swarmabs_config.scenario import parse_scenario
from swarmabs_config.theory import setting
from swarmabs_core.theory.state_feedback import Estimate, estimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from swarmabs_analysis.sweep.study import Study

NAME = "region"
ANGLE, ANGULAR_VELOCITY = "plane.angle", "plane.angular_velocity"
UNITS = {
    "angle": "rad",
    "angular_velocity": "rad/s",
    "mass": "kg",
    "damping": "N s/m",
    "position": "m",
    "inertia": "kg m²",
    "length": "m",
    "torque_max": "N m",
    "duration": "s",
    "step": "s",
    "force": "N",
    "velocity": "m/s",
    "amplitude": "N m",
    "angular_frequency": "rad/s",
    "steps": "steps",
}
"""Units of parameters by the last part of their path."""
BLACK = "#000000"
# From light to dark in the order of the outcomes: distinct with any colour vision, and in greyscale.
LOOKS = {
    "settled": ("#e4eef6", "settles within 10 mrad"),
    "unsettled": ("#f0e442", "stays up, but does not settle"),
    "off_plane": ("#e69f00", "a robot leaves the plane"),
    "failed": ("#a33b00", "the run fails: the plane turns over"),
    "refused": ("#222222", "invalid scenario"),
}
MARKERS = {"settled": "o", "unsettled": "s", "off_plane": "^", "failed": "X", "refused": "P"}
_FEW = 30
"""Most values of a parameter for which markers with the same value are moved apart."""
_FEW_MARKERS = 500
_FINE = 201
"""Points per axis at which the outlines of the estimates are computed."""


class _Points(NamedTuple):
    """Coordinates and outcomes of the cases."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    rank: NDArray[np.int64]
    x_ticks: NDArray[np.float64] | None = None
    y_ticks: NDArray[np.float64] | None = None


def pictures(study: Study, rows: Mapping[int, Mapping[str, Any]]) -> dict[str, bytes]:
    """Return the picture as PNG and SVG files by name; none if fewer than two parameters are numeric.

    If both parameters are in the grid, every point is a field in the colour of its worst case, otherwise every case is
    a marker. If only the plane's angle and angular velocity are swept, the estimates of the region of attraction are
    outlined.
    """
    axes = _axes(study)
    if axes is None:
        return {}
    with mpl.rc_context({"svg.hashsalt": "swarmabs", "svg.fonttype": "none", "axes.unicode_minus": True}):
        figure = _draw(study, rows, *axes)
        files = {}
        for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None, "Creator": None})):
            file = io.BytesIO()
            figure.savefig(file, format=kind, metadata=metadata)
            files[f"{NAME}.{kind}"] = file.getvalue()
    return files


def _axes(study: Study) -> tuple[str, str] | None:
    """Return the parameters of the axes."""
    sweep = study.sweep
    numbers = [path for path in sweep.parameters if _is_numeric(study, path)]
    if sweep.picture is not None:
        asked = (sweep.picture.x, sweep.picture.y)
        return asked if set(asked) <= set(numbers) else None
    return (numbers[0], numbers[1]) if len(numbers) > 1 else None


def _is_numeric(study: Study, path: str) -> bool:
    drawn = study.sweep.random.get(path)
    values: Sequence[Any] | None = study.sweep.grid.get(path) if drawn is None else drawn.choice
    several = values is None or len(values) > 1
    return several and all(isinstance(v, int | float) and not isinstance(v, bool) for v in values or ())


def _draw(study: Study, rows: Mapping[int, Mapping[str, Any]], x: str, y: str) -> Figure:
    sweep = study.sweep
    points = _points(study, rows, x, y)
    fields = x in sweep.grid and y in sweep.grid
    show = _fields if fields else _markers
    estimated = None
    if {x, y} == set(sweep.parameters) == {ANGLE, ANGULAR_VELOCITY}:
        estimated = estimate(setting(parse_scenario(study.scenario), sweep.attraction.angle_max))
    figure = Figure(figsize=(7.6, 5.6) if estimated is None else (10.4, 5.6), dpi=150, layout="constrained")
    ratios = [1.0] if estimated is None else [1.9, 1.0]
    panels: list[Axes] = list(figure.subplots(1, len(ratios), width_ratios=ratios, squeeze=False)[0])
    for axes in panels:
        show(axes, points)
        axes.set(xlabel=_label(x), ylabel=_label(y))
        for axis, values in ((axes.xaxis, points.x_ticks), (axes.yaxis, points.y_ticks)):
            if values is not None:
                axis.set_ticks(values)
    handles = [_handle(name, fields=fields) for rank, name in enumerate(OUTCOMES) if rank in points.rank]
    if estimated is not None:
        handles += _outlines(panels, estimated, upright=x == ANGLE)
    per_place = sweep.count // len({*zip(points.x, points.y, strict=True)}) if fields else 1
    panels[0].set_title(sweep.name if per_place == 1 else f"{sweep.name}: worst of {per_place} cases per point")
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _points(study: Study, rows: Mapping[int, Mapping[str, Any]], x: str, y: str) -> _Points:
    """Return the cases, sorted from best to worst."""
    cases = [study.case(index) for index in range(study.sweep.count)]
    rank = np.array([OUTCOMES.index(rows[case.index]["outcome"]) for case in cases])
    order = np.argsort(rank, kind="stable")
    places = [np.array([float(case.values[path]) for case in cases]) for path in (x, y)]
    if x in study.sweep.grid and y in study.sweep.grid:
        return _Points(places[0][order], places[1][order], rank[order])
    (x_place, x_ticks), (y_place, y_ticks) = (_moved_apart(place) for place in places)
    return _Points(x_place[order], y_place[order], rank[order], x_ticks, y_ticks)


def _moved_apart(place: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Move coordinates that share few values apart in a fixed pattern, so that no marker hides another.

    Also return these values, for the ticks of the axis.
    """
    values = np.unique(place)
    if not 1 < len(values) <= _FEW or len(values) > len(place) // 2:
        return place, None
    pattern = np.arange(len(place)) * 0.6180339887498949 % 1.0 - 0.5
    return place + 0.7 * float(np.min(np.diff(values))) * pattern, values


def _fields(axes: Axes, points: _Points) -> None:
    columns, column = np.unique(points.x, return_inverse=True)
    lines, line = np.unique(points.y, return_inverse=True)
    worst = np.zeros((len(lines), len(columns)), dtype=np.int64)
    np.maximum.at(worst, (line, column), points.rank)
    colours = ListedColormap([LOOKS[name][0] for name in OUTCOMES])
    norm = BoundaryNorm(np.arange(len(OUTCOMES) + 1) - 0.5, len(OUTCOMES))
    axes.pcolormesh(columns, lines, worst, cmap=colours, norm=norm, shading="nearest", rasterized=True)


def _markers(axes: Axes, points: _Points) -> None:
    for rank, name in enumerate(OUTCOMES):
        chosen = points.rank == rank
        axes.scatter(
            points.x[chosen],
            points.y[chosen],
            s=28.0 if len(points.x) <= _FEW_MARKERS else 10.0,
            marker=MARKERS[name],
            facecolor=LOOKS[name][0],
            edgecolor=BLACK,
            linewidth=0.5,
        )


def _outlines(panels: Sequence[Axes], estimated: Estimate, *, upright: bool) -> list[Line2D]:
    """Draw the boundaries of the estimates, magnified in the second panel; return their legend entries."""
    whole, near = panels
    limits = whole.get_xlim(), whole.get_ylim()
    levels = (
        (estimated.printed, ":", "estimate as printed in the paper"),
        (estimated.corrected, "-", "estimate with the corrected η"),
    )
    seen = _contours(whole, estimated, levels, upright=upright)
    whole.set(xlim=limits[0], ylim=limits[1])
    if len(seen):
        middle, half = (seen.max(axis=0) + seen.min(axis=0)) / 2.0, 0.65 * np.ptp(seen, axis=0)
        near.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
        limits = near.get_xlim(), near.get_ylim()
        _contours(near, estimated, levels, upright=upright)
        near.set(xlim=limits[0], ylim=limits[1])
        (left, right), (low, high) = limits
        whole.plot([left, right, right, left, left], [low, low, high, high, low], color=BLACK, linewidth=0.8)
    near.set_title("near the estimates")
    return [Line2D([], [], color=BLACK, ls=style, label=f"{text}: |z|² ≤ {level:.3g}") for level, style, text in levels]


def _contours(
    axes: Axes, estimated: Estimate, levels: Sequence[tuple[float, str, str]], *, upright: bool
) -> NDArray[np.float64]:
    """Draw the boundaries of the estimates; return their points."""
    x, y = np.meshgrid(np.linspace(*axes.get_xlim(), _FINE), np.linspace(*axes.get_ylim(), _FINE))
    squared = np.vectorize(estimated.error_squared)(*((x, y) if upright else (y, x)))
    points = [np.empty((0, 2))]
    for level, style, _ in levels:
        drawn = axes.contour(x, y, squared, levels=[level], colors=BLACK, linewidths=1.5, linestyles=[style])
        points += [np.asarray(path.vertices) for path in drawn.get_paths()]
    return np.concatenate(points)


def _handle(name: str, *, fields: bool) -> Patch | Line2D:
    colour, text = LOOKS[name]
    if fields:
        return Patch(facecolor=colour, edgecolor=BLACK, linewidth=0.5, label=text)
    return Line2D(
        [], [], linestyle="none", marker=MARKERS[name], markerfacecolor=colour, markeredgecolor=BLACK, label=text
    )


def _label(path: str) -> str:
    unit = UNITS.get(path.rsplit(".", maxsplit=1)[-1])
    return path if unit is None else f"{path}, {unit}"
