"""Panels as pictures: each as an SVG element that uses the colours of the page, several as one PNG."""

from __future__ import annotations

import re
import warnings
from contextlib import contextmanager
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from swarmabs_analysis.figures import style
from swarmabs_analysis.report.formatting import quantity, shown
from swarmabs_bag.shown import colours
from swarmabs_bag.shown.recorded_swarm import column_points
from swarmabs_core.systems.kinds import DOUBLE_INTEGRATOR, SINGLE_INTEGRATOR

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from swarmabs_analysis.report.panels import Panel
    from swarmabs_analysis.report.record import Recorded

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

WIDTH = 3.6
"""Width of a panel in the page, inches: about that of a phone, so that its text is legible there."""
OVERVIEW = (
    *(
        ("parent-0",),
        ("mass", "robots-paths", "robots-coordinate-0"),
        ("abstract-error", "abstract-0"),
    ),
    *(("parent-error",), ("space", "abstract-1"), ("margin-end", "margins-gram")),
)
"""The panels of the PNG, row by row; of several for one place, the first that exists."""
COLOURS = {
    style.BLACK: "ink",
    style.GREY: "grey",
    style.LIGHT: "light",
    "#dddddd": "grid",
    "#ffffff": "paper",
    colours.PLANE: "plane",
    colours.ERROR: "error",
    colours.TORQUE: "torque",
    colours.INERTIA: "inertia",
    SINGLE_INTEGRATOR.colour: "single",
    DOUBLE_INTEGRATOR.colour: "double",
    colours.FAILED: "failed",
    colours.SAFE_STOP: "safe-stop",
    colours.ABSENT: "absent",
}
"""The variable of the page's style sheet for each colour."""

PNG_MARK = "swarmabs report"
"""Marks a PNG file as part of a report."""

_CELL = 0.5
"""Width of a column, points."""
_FEW = 500
"""Points up to which a line is not thinned."""
_MOST = 4000
"""Most points of a line that is not a function of x."""

_NAMESPACE = re.compile(r"^\{[^}]*\}")
_FONT = re.compile(r"font-family:[^;]*;? ?")
_UPRIGHT = re.compile(r"rotate\(-?0 [^)]*\) ?")
_NUMBER = re.compile(r"-?\d+\.\d{3,}")
_COLOUR = re.compile(r"#[0-9a-f]{6}\b")
_REFERENCE = re.compile(r"url\(#([^)]*)\)")
_SETTINGS = {"savefig.dpi": 160, "figure.dpi": 160}


def page_picture(panel: Panel) -> Markup:
    """Return a panel as an ``svg`` element without namespaces whose colours are variables of the page."""
    with _drawing():
        figure = Figure(figsize=(WIDTH, panel.height), layout="constrained")
        figure.patch.set_visible(False)
        panel.draw(figure)
        for axes in figure.axes:
            axes.patch.set_visible(False)
        svg = style.rendered(figure, ["svg"], finish=thin_lines)["svg"]
    root = ET.fromstring(svg)  # noqa: S314 - matplotlib's own output
    picture = _inlined(root, panel.key)
    picture.set("role", "img")
    picture.set("aria-label", f"{panel.heading}. {panel.about}")
    return Markup(ET.tostring(picture, encoding="unicode", method="html"))  # noqa: S704 - escaped by the tree


def overview(recorded: Recorded, panels: Mapping[str, Panel]) -> bytes:
    """Return the most informative panels as a PNG file titled with the run's name and state."""
    places = [[panels[key] for key in keys if key in panels] for keys in OVERVIEW]
    chosen = [place[0] for place in places if place]
    with _drawing():
        columns = 3
        rows = max(1, -(-len(chosen) // columns))
        figure = Figure(figsize=(13.0, 0.7 + 3.1 * rows), layout="constrained")
        figure.suptitle(_title(recorded), fontsize=10, parse_math=False)
        parts = np.ravel(figure.subfigures(rows, columns, squeeze=False, wspace=0.02, hspace=0.03))
        for part, panel in zip(parts, chosen, strict=False):
            panel.draw(part)
            part.suptitle(panel.heading, fontsize=8.5)
        if not chosen:
            figure.text(0.5, 0.4, "fewer than two steps are recorded: nothing to draw", ha="center")
        return style.rendered(figure, ["png"], PNG_MARK, finish=thin_lines)["png"]


@contextmanager
def _drawing() -> Iterator[None]:
    with warnings.catch_warnings(), style.styled(_SETTINGS):
        # Names may contain characters that the font lacks, and damaged bags quantities without any value.
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        warnings.filterwarnings("ignore", "All-NaN", RuntimeWarning)
        yield


def _title(recorded: Recorded) -> str:
    metrics = recorded.metrics
    rms = metrics["rms_error"]
    parts = [
        shown(recorded.scenario.name),
        f"{len(recorded.arrays.agents.ids)} robots",
        f"{recorded.steps} steps",
        recorded.swarm.status,
        f"rms error {quantity(rms, recorded.tracking.unit)}" if isinstance(rms, float) else "",
        f"digest {str(metrics['digest'])[:16]}…" if metrics["digest"] else "",
    ]
    return "   ·   ".join(part for part in parts if part)


def _inlined(root: ET.Element, key: str) -> ET.Element:
    """Return matplotlib's SVG as an element of a page, with ids that are unique in the page."""
    text = ET.tostring(root, encoding="unicode")
    used = set(_REFERENCE.findall(text)) | set(re.findall(r'href="#([^"]*)"', text))
    for element in root.iter():
        element.tag = _NAMESPACE.sub("", element.tag)
        for name in list(element.attrib):
            value = element.attrib.pop(name)
            name = _NAMESPACE.sub("", name)  # noqa: PLW2901 - the name without its namespace
            if name == "id":
                if value not in used:
                    continue
                value = f"{key}-{value}"
            elif name == "href" and value.startswith("#"):
                value = f"#{key}-{value[1:]}"
            elif name in {"d", "x", "y", "transform"}:
                value = _NUMBER.sub(lambda digits: f"{float(digits[0]):.2f}", _UPRIGHT.sub("", value))
                if not value:
                    continue
            elif name == "style":
                value = _COLOUR.sub(lambda colour: _variable(colour[0]), _FONT.sub("", value))
            element.set(name, _REFERENCE.sub(rf"url(#{key}-\1)", value))
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in {"metadata", "style"}:
                parent.remove(child)
    for name in ("width", "height", "version"):
        root.attrib.pop(name, None)
    return root


def _variable(colour: str) -> str:
    name = COLOURS.get(colour)
    return colour if name is None else f"var(--{name})"


def thin_lines(figure: Figure) -> None:
    """Thin all lines of a figure whose layout and limits are final, without a visible change."""
    scale = 72.0 / figure.dpi / _CELL
    for axes in figure.axes:
        axes.set_autoscale_on(False)
        for line in axes.lines:
            points = np.column_stack([np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)])
            if len(points) > _FEW and line.get_transform() == axes.transData:
                chosen = _chosen(axes, points, scale)
                line.set_data(points[chosen, 0], points[chosen, 1])


def _chosen(axes: Axes, points: Floats, scale: float) -> Integers:
    with np.errstate(all="ignore"):
        places = axes.transData.transform(points) * scale
    places[~np.isfinite(places)] = np.nan
    if not np.isnan(places[:, 0]).any() and (np.diff(points[:, 0]) >= 0).all():
        return column_points(np.floor(places[:, 0]).astype(np.int64), points[:, 1])
    # A path that fills an area: keep one point per cell, and coarsen the cells until few points remain.
    chosen = np.arange(len(points))
    cells = np.where(np.isnan(places), -1.0, places - np.nanmin(places, axis=0, initial=np.inf))
    while len(chosen) > _MOST and (cells > 0).any():
        moved = np.any(np.floor(cells[1:]) != np.floor(cells[:-1]), axis=1)
        chosen = np.concatenate([[0], np.flatnonzero(moved) + 1])
        cells = np.where(cells < 0, cells, np.where(cells < 1.0, 0.0, cells / 2.0))
    return chosen[:: -(-len(chosen) // _MOST)]
