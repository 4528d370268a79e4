"""The picture of a sweep: a result and the outcomes of the cases over up to three parameters."""

from __future__ import annotations

import io
import json
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from swarmabs_analysis.sweep.evaluate import OUTCOMES
from swarmabs_analysis.sweep.table import metrics_of, unit_of
from swarmabs_bag.run.figures import PLANE_TRACKING, TOLERANCE, tracking_of
from swarmabs_bag.shown.colours import ABSENT, FAILED, PLANE, REFERENCE, tint
from swarmabs_config.scenario import SystemScenario, parse_scenario
from swarmabs_config.theory import attraction
from swarmabs_core.theory.state_feedback import Estimate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from swarmabs_analysis.sweep.evaluate import Row
    from swarmabs_analysis.sweep.study import Study
    from swarmabs_config.scenario import Scenario

    Floats = NDArray[np.float64]
    Rows = Mapping[int, Row]

NAME = "region"
ANGLE, ANGULAR_VELOCITY = "plane.angle", "plane.angular_velocity"
MAP = "viridis"
# The greys and the red differ in lightness, and from every colour of the map.
LOOKS = {
    "settled": (tint(PLANE, 0.1), f"settles within {1e3 * TOLERANCE:g} mrad"),
    "unsettled": (tint(ABSENT, 0.35), "stays up, but does not settle"),
    "off_plane": (tint(ABSENT, 0.8), "a robot leaves the plane"),
    "failed": (FAILED, "the run fails: the plane turns over"),
    "refused": (REFERENCE, "invalid scenario"),
}
LABELS = {
    "settled": "settles",
    "unsettled": "does not settle",
    "off_plane": "a robot leaves its range",
    "failed": "the run fails",
    "refused": LOOKS["refused"][1],
}
"""The texts of `LOOKS` for other parent systems than the plane."""
MARKERS = {"settled": "o", "unsettled": "s", "off_plane": "^", "failed": "X", "refused": "P"}
_FEW = 30
"""Most values of a parameter for which markers with the same value are moved apart."""
_APART = 0.35
"""How far such markers are moved at most, as a part of the smallest spacing of the values."""
_FEW_TICKS, _FEW_PANELS, _RANGES = 5, 6, 3
"""Most values with a tick or a panel each; the number of ranges for a third parameter with more values."""
_DECADES = 30.0
"""Ratio of largest to smallest result above which the scale is logarithmic."""
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_BANDS = ((tint(PLANE, 0.2), "90 % of the cases"), (tint(PLANE, 0.45), "50 % of the cases"))
_OFF_PLANE = OUTCOMES.index("off_plane")
"""Index of the first outcome without a meaningful result."""
_FINE = 201
"""Points per axis at which the outlines of the estimates are computed."""


class _Cases(NamedTuple):
    """Cases, (N,) each: coordinates, result (NaN for none), and index of the outcome.

    They are `gridded` if all axes are of the grid.
    """

    places: Sequence[Floats]
    result: Floats
    outcome: NDArray[np.int64]
    gridded: bool

    def where(self, chosen: NDArray[np.bool_]) -> _Cases:
        """Return the selected cases."""
        places = [place[chosen] for place in self.places]
        return self._replace(places=places, result=self.result[chosen], outcome=self.outcome[chosen])

    @property
    def repeated(self) -> bool:
        """Whether several cases have the same coordinates."""
        return len(set(zip(*self.places, strict=True))) < len(self.outcome)


class _Subject(NamedTuple):
    """The contents of the picture: the parameters of the axes, the parameter of the panels, and the result."""

    axes: Sequence[str]
    panels: str | None
    metric: str | None


def pictures(study: Study, rows: Rows) -> dict[str, bytes]:
    """Return the picture as PNG and SVG files by name; none if no parameter is numeric.

    It shows the first of the sweep's results that exists for at least half of the cases in which all robots stay on the
    plane. Over one parameter it is a line, with bands for repeated cases; over two it is a map of fields if both are in
    the grid, otherwise of markers. A third parameter has a panel for each of its values. If only the plane's angle and
    angular velocity are swept, the estimates of the region of attraction are outlined.
    """
    subject = _subject(study, rows)
    if not subject.axes or (len(subject.axes) == 1 and subject.metric is None):
        return {}
    with mpl.rc_context({"svg.hashsalt": "swarmabs", "svg.fonttype": "none", "axes.unicode_minus": True}):
        figure = _draw(study, rows, subject)
        files = {}
        for kind, metadata in (("png", {"Software": None}), ("svg", {"Date": None, "Creator": None})):
            file = io.BytesIO()
            figure.savefig(file, format=kind, metadata=metadata)
            files[f"{NAME}.{kind}"] = file.getvalue()
    return files


def _subject(study: Study, rows: Rows) -> _Subject:
    """Choose the contents of the picture."""
    sweep = study.sweep
    choices = {
        path: sweep.random[path].choice if path in sweep.random else sweep.grid[path] for path in sweep.parameters
    }
    varied = [path for path, values in choices.items() if values is None or len(values) > 1]
    numbers = [path for path in varied if all(map(_is_number, choices[path] or ()))]
    axes = numbers[:2]
    if sweep.picture is not None:
        axes = [sweep.picture.x, sweep.picture.y]
        axes = axes if set(axes) <= set(numbers) else []
    others = [path for path in varied if path not in axes]
    panels = others[0] if len(others) == 1 else None
    if panels is not None and panels not in numbers and len(choices[panels] or ()) > _FEW_PANELS:
        panels = None
    upright = [row for row in rows.values() if OUTCOMES.index(row["outcome"]) < _OFF_PLANE]
    counts = {name: sum(row.get(name) is not None for row in upright) for name in sweep.results}
    drawable = metrics_of(PLANE_TRACKING)
    metric = next(
        (name for name, count in counts.items() if name in drawable and 2 * count >= max(len(upright), 1)), None
    )
    return _Subject(axes, panels, metric)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _draw(study: Study, rows: Rows, subject: _Subject) -> Figure:
    sweep, scenario = study.sweep, parse_scenario(study.scenario)
    estimated = None
    if set(subject.axes) == set(sweep.parameters) == {ANGLE, ANGULAR_VELOCITY}:
        estimated = attraction(scenario, sweep.attraction.angle_max)
    cases = _cases(study, rows, subject)
    parts, ratios, size = [("", cases.outcome >= 0)], [1.0], (7.6, 5.6)
    if estimated is not None:
        parts, ratios, size = [*parts, ("near the estimates", parts[0][1])], [1.9, 1.0], (11.4, 5.6)
    elif subject.panels is not None:
        parts = _parts(study, scenario, subject.panels)
        ratios = [1.0] * min(len(parts), 3)
        size = (2.4 + 3.2 * len(ratios), 1.8 + 2.8 * -(-len(parts) // len(ratios)))
    figure = Figure(figsize=size, dpi=150, layout="constrained")
    lines, shared = -(-len(parts) // len(ratios)), estimated is None
    grid = figure.subplots(lines, len(ratios), width_ratios=ratios, sharex=shared, sharey=shared, squeeze=False)
    panels: list[Axes] = list(grid.flat[: len(parts)])
    for unused in grid.flat[len(parts) :]:
        unused.remove()

    scale = _scale(cases.result)
    show = _curve if len(subject.axes) == 1 else _fields if cases.gridded else _markers
    labels = [_label(scenario, path) for path in subject.axes]
    looks = LABELS if isinstance(scenario, SystemScenario) else {name: label for name, (_, label) in LOOKS.items()}
    metric = metrics_of(tracking_of(scenario)).get(subject.metric or "", "")
    for number, (axes, (title, chosen)) in enumerate(zip(panels, parts, strict=True)):
        show(axes, cases.where(chosen), scale)
        axes.set_title(title, fontsize="medium")
        if number % len(ratios) == 0:
            axes.set_ylabel([*labels, metric][1])
        if number + len(ratios) >= len(parts):
            axes.set_xlabel(labels[0])
            axes.tick_params(labelbottom=True)
        for axis, place in zip((axes.xaxis, axes.yaxis), cases.places, strict=False):
            if len(ticks := np.unique(place)) <= _FEW_TICKS:
                axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks.tolist()])
    handles = _handles(cases, looks, fields=show is _fields)
    if show is _markers and any(_hides(place[chosen]) for _, chosen in parts for place in cases.places):
        moved = f"markers of equal values are moved by up to {_APART:.0%} of the spacing"
        handles.append(Line2D([], [], ls="none", label=moved))
    if metric and show is not _curve:
        median = " (median)" if cases.gridded and cases.where(parts[0][1]).repeated else ""
        figure.colorbar(ScalarMappable(scale, MAP), ax=panels, label=metric + median)
    if estimated is not None:
        handles += _outlines(panels, estimated, upright=subject.axes[0] == ANGLE)
    figure.suptitle(sweep.name)
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _cases(study: Study, rows: Rows, subject: _Subject) -> _Cases:
    values = [case.values for case in study.cases()]
    ordered = [rows[index] for index in range(len(values))]
    outcome = np.array([OUTCOMES.index(row["outcome"]) for row in ordered])
    result = np.array([row.get(subject.metric or "") for row in ordered], dtype=float)
    return _Cases(
        [np.array([float(one[path]) for one in values]) for path in subject.axes],
        np.where(outcome < _OFF_PLANE, result, np.nan),
        outcome,
        set(subject.axes) <= set(study.sweep.grid),
    )


def _parts(study: Study, scenario: Scenario, path: str) -> list[tuple[str, NDArray[np.bool_]]]:
    """Return heading and cases of each panel: one per value of a parameter, or per range of many values."""
    values = [case.values[path] for case in study.cases()]
    texts = np.array([json.dumps(value).strip('"') for value in values])
    distinct = list(dict.fromkeys(texts.tolist()))
    if len(distinct) <= _FEW_PANELS:
        return [(_label(scenario, path, text), texts == text) for text in distinct]
    numbers = np.array(values, dtype=float)
    ranges = [(part[0], part[-1]) for part in np.array_split(np.unique(numbers), _RANGES)]
    return [
        (_label(scenario, path, f"{low:.3g} to {high:.3g}"), (low <= numbers) & (numbers <= high))
        for low, high in ranges
    ]


def _label(scenario: Scenario, path: str, value: str = "") -> str:
    """Return the name of a parameter, with the id of its robot, and its value or unit."""
    unit = unit_of(scenario, path)
    robot, listed = re.match(r"swarm\.agents\.(\d+)\.", path), scenario.swarm.agents
    name = f"{path} (robot {listed[int(robot[1])].id})" if robot and listed else path
    return f"{name}\n{value} {unit}".rstrip() if value else f"{name}, {unit}".removesuffix(", ")


def _scale(result: Floats) -> Normalize:
    """Return the common scale of the results, logarithmic if they span decades."""
    finite = result[np.isfinite(result)]
    low, high = (float(np.min(finite)), float(np.max(finite))) if len(finite) else (0.0, 1.0)
    return LogNorm(low, high) if 0.0 < _DECADES * low < high else Normalize(low, high)


def _curve(axes: Axes, cases: _Cases, scale: Normalize) -> None:
    """Draw results over one parameter, as bands where cases share a value; mark other outcomes below."""
    place, finite = cases.places[0], np.isfinite(cases.result)
    if cases.repeated:
        values = np.unique(place[finite])
        quantiles = [np.quantile(cases.result[finite & (place == value)], _QUANTILES) for value in values]
        lowest, low, middle, high, highest = np.reshape(quantiles, (-1, len(_QUANTILES))).T
        for lower, upper, (colour, _) in zip((lowest, low), (highest, high), _BANDS, strict=True):
            axes.fill_between(values, lower, upper, color=colour, linewidth=0.0)
        axes.plot(values, middle, color=PLANE, marker=".")
    else:
        order = np.argsort(place)
        style = "-" if cases.gridded else "none"
        axes.plot(place[order], cases.result[order], color=PLANE, marker=".", linestyle=style)
    if isinstance(scale, LogNorm):
        axes.set_yscale("log")
    margin = 0.03 * float(np.ptp(place))
    axes.set_xlim(float(np.min(place)) - margin, float(np.max(place)) + margin)
    order = np.lexsort((cases.outcome, place))
    worst = order[np.append(np.diff(place[order]) > 0, True)]
    for number, name in list(enumerate(OUTCOMES))[1:]:
        marked = place[worst[cases.outcome[worst] == number]]
        edge = axes.get_xaxis_transform()
        axes.scatter(marked, np.zeros(len(marked)), transform=edge, clip_on=False, zorder=3.0, **_marker(name))


def _fields(axes: Axes, cases: _Cases, scale: Normalize) -> None:
    """Draw each point of a grid in the colour of its median result or worst outcome; mark worse outcomes in it."""
    (columns, column), (lines, line) = (np.unique(place, return_inverse=True) for place in cases.places)
    worst = np.full((len(lines), len(columns)), -1)
    np.maximum.at(worst, (line, column), cases.outcome)
    median = np.full(worst.shape, np.nan)
    field = line * len(columns) + column
    finite = np.flatnonzero(np.isfinite(cases.result))
    finite = finite[np.argsort(field[finite], kind="stable")]
    there, begins = np.unique(field[finite], return_index=True)
    median.flat[there] = [np.median(part) for part in np.split(cases.result[finite], begins[1:]) if len(part)]
    drawn = np.isfinite(median)
    colours = ListedColormap([LOOKS[name][0] for name in OUTCOMES])
    norm = BoundaryNorm(np.arange(len(OUTCOMES) + 1) - 0.5, len(OUTCOMES))
    plain = np.ma.masked_where(drawn | (worst < 0), worst)
    axes.pcolormesh(columns, lines, plain, cmap=colours, norm=norm, shading="nearest", rasterized=True)
    if drawn.any():
        results = np.ma.masked_invalid(median)
        axes.pcolormesh(columns, lines, results, cmap=MAP, norm=scale, shading="nearest", rasterized=True)
    for number, name in list(enumerate(OUTCOMES))[1:]:
        marked = np.nonzero(drawn & (worst == number))
        axes.scatter(columns[marked[1]], lines[marked[0]], **_marker(name, worst.size))


def _markers(axes: Axes, cases: _Cases, scale: Normalize) -> None:
    """Draw a marker for each case: the shape shows the outcome, the colour the result, if any."""
    x, y = (_moved_apart(place) for place in cases.places)
    for number, name in enumerate(OUTCOMES):
        for coloured in (False, True):
            chosen = (cases.outcome == number) & (np.isfinite(cases.result) == coloured)
            look = _marker(name, len(x)) | ({"c": cases.result[chosen], "cmap": MAP, "norm": scale} if coloured else {})
            axes.scatter(x[chosen], y[chosen], **look)


def _marker(name: str, count: int = 1) -> dict[str, Any]:
    """Return the marker of an outcome, sized for the number of markers."""
    size = float(np.clip(8000.0 / count, 8.0, 40.0))
    return {"marker": MARKERS[name], "s": size, "c": LOOKS[name][0], "edgecolors": REFERENCE, "linewidths": 0.5}


def _hides(place: Floats) -> bool:
    """Return whether coordinates share few values, so that markers hide each other."""
    count = len(np.unique(place))
    return 1 < count <= min(_FEW, len(place) // 2)


def _moved_apart(place: Floats) -> Floats:
    """Move coordinates that share few values apart in a fixed pattern, so that no marker hides another."""
    if not _hides(place):
        return place
    values = np.unique(place)
    pattern = np.arange(len(place)) * 0.6180339887498949 % 1.0 - 0.5
    return place + 2.0 * _APART * float(np.min(np.diff(values))) * pattern


def _handles(cases: _Cases, labels: Mapping[str, str], *, fields: bool) -> list[Patch | Line2D]:
    """Return the legend entries: the bands, and a patch or a marker for each outcome that occurs."""
    handles: list[Patch | Line2D] = []
    if len(cases.places) == 1 and cases.repeated:
        handles = [Patch(color=colour, label=label) for colour, label in _BANDS]
        handles.append(Line2D([], [], color=PLANE, marker=".", label="median"))
    for number in np.unique(cases.outcome).tolist():
        name = OUTCOMES[number]
        colour, label = LOOKS[name][0], labels[name]
        bare = cases.outcome[np.isnan(cases.result)]
        if fields and number in bare:
            handles.append(Patch(facecolor=colour, edgecolor=REFERENCE, linewidth=0.5, label=label))
        elif number > 0 or not (fields or len(cases.places) == 1):
            handles.append(Line2D([], [], ls="none", marker=MARKERS[name], mfc=colour, mec=REFERENCE, label=label))
    return handles


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
        whole.plot([left, right, right, left, left], [low, low, high, high, low], color=REFERENCE, linewidth=0.8)
    return [
        Line2D([], [], color=REFERENCE, ls=style, label=f"{text}: |z|² ≤ {level:.3g}") for level, style, text in levels
    ]


def _contours(
    axes: Axes, estimated: Estimate, levels: Sequence[tuple[float, str, str]], *, upright: bool
) -> NDArray[np.float64]:
    """Draw the boundaries of the estimates; return their points."""
    x, y = np.meshgrid(np.linspace(*axes.get_xlim(), _FINE), np.linspace(*axes.get_ylim(), _FINE))
    squared = np.vectorize(estimated.error_squared)(*((x, y) if upright else (y, x)))
    points = [np.empty((0, 2))]
    for level, style, _ in levels:
        drawn = axes.contour(x, y, squared, levels=[level], colors=REFERENCE, linewidths=1.5, linestyles=[style])
        drawn.set(path_effects=[withStroke(linewidth=3.5, foreground="white")])
        points += [np.asarray(path.vertices) for path in drawn.get_paths()]
    return np.concatenate(points)
