"""What the pictures of figures, reports and sweeps show: texts, lines and areas in numbers, without pixels."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from matplotlib.collections import Collection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure, FigureBase
from matplotlib.text import Text
from tests.frozen.command import frozen
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_bag.realtime_bags import realtime_bag

from swarmabs_analysis.figures import FIGURES
from swarmabs_analysis.figures.runs import find_runs
from swarmabs_analysis.figures.style import styled
from swarmabs_analysis.report.panels import panels
from swarmabs_analysis.report.record import read_recorded
from swarmabs_analysis.sweep.evaluate import OUTCOMES
from swarmabs_analysis.sweep.picture import pictures
from swarmabs_analysis.sweep.study import load_sweep

FAULTS = (
    "faults=[{at: 0.05, kind: kill, agent: 1}, {at: 0.1, kind: leave, agent: 2}, {at: 0.02, kind: join, agent: 4},"
    " {kind: lie, agent: 3, position_offset: 0.01}]"
)
REPORTS = {
    "faults": ("pd_het_4", "duration=0.2", "plane.angle=0.015", FAULTS),
    "estimated": ("pd_si_4", "duration=5.5", "observer.type=parent_response", "plane.sensor.noise=[0.01, 0.001]"),
    "twenty": ("arise_het_20", "duration=0.1", "limits={velocity: 0.01}"),
    "many": (
        *("arise_het_200", "duration=0.1", "swarm.sensor.noise=[0.0001, 0]"),
        "faults=[{at: 0.05, kind: leave, agent: 2}, {kind: lie, agent: 3, mass_factor: 1.1}]",
    ),
}
ANGLES = "plane.angle: {from: -1, to: 1, count: 5}"
RATES = "plane.angular_velocity: {from: -2, to: 1, count: 7}"
SWEEPS = {
    "fields": f"grid: {{{ANGLES}, {RATES}}}",
    "upright": f"grid: {{{RATES}, {ANGLES}}}\npicture: {{x: plane.angular_velocity, y: plane.angle}}",
    "worst": "grid: {limits.force: [1, 2], plane.length: [1, 2]}\nsamples: 3",
    "markers": "random: {plane.angle: {uniform: [0, 1]}, plane.inertia: {normal: [1, 0.1]}}\nsamples: 40",
    "spread": "random: {plane.angle: {uniform: [0, 1]}}\ngrid: {swarm.actuator_lag: [0.1, 0.2]}\nsamples: 300",
}


class Drawn(Figure):
    """A figure that is kept, and not saved."""

    last: "Drawn"

    def savefig(self, *_: Any, **__: Any) -> None:
        Drawn.last = self


def _figure(name: str, folder: Path) -> dict[str, Any]:
    needed = FIGURES[name].scenarios
    for scenario in needed:
        record(folder / scenario, scenario, "duration=0.1")
    found = find_runs([folder], needed) if needed else {}
    with styled():
        return outline(FIGURES[name].draw([found[scenario].load() for scenario in needed]))


def _report(name: str, folder: Path) -> dict[str, Any]:
    bag = realtime_bag(folder, "brief") if name == "realtime" else record(folder, *REPORTS[name])
    whole: dict[str, Any] = {"texts": [], "numbers": []}
    for panel in panels(read_recorded(bag)):
        with styled():
            figure = Figure()
            panel.draw(figure)
            found = outline(figure)
        whole["texts"] += [panel.heading, panel.about, panel.note, *found["texts"]]
        whole["numbers"] += [panel.height, *found["numbers"]]
    return whole


def _sweep(name: str, folder: Path) -> dict[str, Any]:
    folder.mkdir(parents=True)
    (folder / "swept.yaml").write_text(f"schema: 1\nscenario: pd_het_4\n{SWEEPS[name]}\n", encoding="utf-8")
    study = load_sweep(folder / "swept.yaml")
    with patch("swarmabs_analysis.sweep.picture.Figure", Drawn):
        pictures(study, {n: {"outcome": OUTCOMES[3 * n % len(OUTCOMES)]} for n in range(study.sweep.count)})
    return outline(Drawn.last)


CASES: dict[str, Callable[[str, Path], dict[str, Any]]] = {
    **dict.fromkeys(FIGURES, _figure),
    **dict.fromkeys((*REPORTS, "realtime"), _report),
    **dict.fromkeys(SWEEPS, _sweep),
}


def found(name: str, folder: Path) -> dict[str, Any]:
    """Draw a picture or those of a report, and return their outline."""
    return CASES[name](name, folder / "case")


def outline(figure: FigureBase) -> dict[str, Any]:
    """Return the texts of a figure and numbers of all that is drawn in it, in their order."""
    texts, numbers = [text.get_text() for text in figure.findobj(_is_text)], [*figure.get_size_inches()]
    for axes in figure.axes:
        texts += [axes.get_xscale(), axes.get_yscale()]
        numbers += [*axes.get_xlim(), *axes.get_ylim(), *_told(axes.get_xticks(), axes.get_yticks())]
        for line in axes.lines:
            texts.append(f"{to_hex(line.get_color())} {line.get_linestyle()} {line.get_marker()}")
            data = line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data()
            numbers += [line.get_linewidth(), line.get_markersize(), line.get_zorder(), *_told(*data)]
        for collection in axes.collections:
            colours = np.asarray(collection.get_facecolor(), dtype=float)
            numbers += [*_told(colours), *_told(np.asarray(collection.get_offsets())), *_shape(collection)]
    return {"texts": [text for text in texts if text], "numbers": [float(f"{number:.8g}") for number in numbers]}


def _is_text(artist: object) -> bool:
    return isinstance(artist, Text) and artist.get_visible()


def _told(*data: Any) -> Iterator[float]:
    for values in (np.ma.filled(np.ma.asarray(found, dtype=float), np.nan).ravel() for found in data):
        finite = values[np.isfinite(values)]
        yield from (len(values), len(finite))
        if len(finite):
            yield from (finite[0], finite[-1], finite.min(), finite.max(), finite.mean())


def _shape(collection: Collection) -> Iterator[float]:
    corners = np.concatenate([np.empty((0, 2)), *(path.vertices for path in collection.get_paths())])
    yield from (len(collection.get_paths()), *_told(corners[:, 0], corners[:, 1]))
    if collection.get_array() is not None:
        yield from (*_told(collection.get_array()), *collection.get_clim())
    yield from (collection.get_zorder(), *_told(collection.get_linewidths()))


PICTURES = frozen("pictures")
