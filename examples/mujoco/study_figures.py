"""The figures of the study, in the style of the project's other figures."""

from __future__ import annotations

from io import BytesIO
from math import inf, isinf
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from mujoco_setup import rig_of
from mujoco_trial import SETTLED
from PIL import Image
from study_maps import ARISE, PRINTED, SEEDED
from study_trials import states_on

from swarmabs_analysis.figures import style
from swarmabs_core.errors import RunError
from swarmabs_run.simulation import simulate

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from study import Row
    from study_maps import Map
    from study_trials import Outcome

    from swarmabs_config.scenario import PlaneScenario

COLOURS = {
    "PD": style.BLACK,
    "LQR": style.GREY,
    "ARISE as printed": style.VERMILION,
    "ARISE": style.BLUE,
    "ARISE, reference": style.BLUE,
    "LQR, torque estimated": style.GREEN,
    "LQR, k_sd = 5": style.YELLOW,
    "LQR, narrow manifold": style.PURPLE,
    "PID": style.ORANGE,
    "LQR, height compensated": style.SKY,
}
"""Colour of a loop, by its name."""
MARKERS = dict(zip(COLOURS, "osPDv<^Xdp", strict=True))
SHADES = 64
"""Number of colours in a file, which is enough for lines and makes it small."""
LOWEST, LOST = 2e-4, 1.0
"""Ends of the axis of errors, rad; trials in which a robot left the plank are drawn at the upper one."""
COLUMNS = 3
HEIGHTS = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03)
"""Heights of the masses for the laws as printed, m."""


def draw_seeds(outcomes: Sequence[Outcome], file: Path) -> None:
    """Draw the share of trials by their error, for each size of the swarm."""
    sizes = sorted({outcome.robots for outcome in outcomes})
    with style.styled():
        figure = Figure(figsize=(style.PAGE, 2.7), layout="constrained")
        grid = figure.subplots(1, len(sizes), sharey=True, squeeze=False)[0]
        for axes, robots in zip(grid, sizes, strict=True):
            for name in dict.fromkeys(outcome.loop for outcome in outcomes):
                errors = sorted(_shown(o.error) for o in outcomes if (o.robots, o.loop) == (robots, name))
                share = 100.0 * np.arange(1, len(errors) + 1) / len(errors)
                axes.step(
                    [LOWEST, *errors, LOST], [0.0, *share, share[-1]], where="post", color=COLOURS[name], label=name
                )
            axes.axvline(SETTLED, color=style.GREY, linestyle=style.DASHED, linewidth=0.8)
            axes.set(title=f"{robots} robots", xlabel="error in the last 2 s, rad", xscale="log", xlim=(LOWEST, LOST))
            axes.grid(visible=True)
        figure.axes[0].set(ylabel="trials with at most this error, %", ylim=(0.0, 101.0))
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
        _save(figure, file)


def draw_maps(rows: Sequence[Row], maps: Sequence[Map], file: Path) -> None:
    """Draw the largest error over each imperfection; open markers are cells in which not every trial settled."""
    with style.styled():
        height = -(-len(maps) // COLUMNS)
        figure = Figure(figsize=(style.PAGE, 0.5 + 1.95 * height), layout="constrained")
        grid = np.atleast_1d(figure.subplots(height, min(len(maps), COLUMNS), sharey=True)).ravel()
        for axes, study in zip(grid, maps, strict=False):
            _draw_map(axes, study, [row for row in rows if row.imperfection == study.name])
        for axes in grid[len(maps) :]:
            axes.set_visible(False)
        for axes in grid[:: min(len(maps), COLUMNS)]:
            axes.set_ylabel("largest error, rad")
        lines = {line.get_label(): line for axes in grid for line in axes.get_lines() if line.get_label() in COLOURS}
        figure.legend(lines.values(), lines, loc="outside upper center", ncols=3)
        _save(figure, file)


def _draw_map(axes: Axes, study: Map, rows: Sequence[Row]) -> None:
    places = range(len(study.values))
    for loop in study.loops:
        cells = {row.value: row for row in rows if row.loop == loop.name}
        line = [cells[value] for value in study.values]
        axes.plot(places, [_shown(row.largest_error) for row in line], color=COLOURS[loop.name], label=loop.name)
        for place, row in zip(places, line, strict=True):
            whole = row.settled == row.trials
            face = COLOURS[loop.name] if whole else "white"
            axes.plot(
                place,
                _shown(row.largest_error),
                marker=MARKERS[loop.name],
                color=COLOURS[loop.name],
                markerfacecolor=face,
                markersize=3.5,
                clip_on=False,
                zorder=3,
            )
    axes.axhline(SETTLED, color=style.GREY, linestyle=style.DASHED, linewidth=0.8)
    axes.set(xlabel=study.label, yscale="log", ylim=(LOWEST, LOST))
    axes.set_xticks(places, [f"{value:g}" for value in study.values])
    axes.grid(visible=True)


def _shown(error: float) -> float:
    return LOST if isinf(error) else min(max(error, LOWEST), LOST)


def draw_printed(file: Path, duration: float) -> None:
    """Draw what the laws as printed and as corrected do for a duration (s), and up to which height of the masses."""
    with style.styled():
        figure = Figure(figsize=(style.PAGE, 2.3), layout="constrained")
        model, rig, heights = figure.subplots(1, 3)
        rig.sharey(model)
        for loop, colour, dashes in ((ARISE, style.BLUE, style.SOLID), (PRINTED, style.VERMILION, style.DASHED)):
            scenario = loop.scenario(4, duration)
            run = simulate(scenario)
            label = "as corrected" if loop is ARISE else "as printed"
            line = {"color": colour, "linestyle": dashes}
            model.plot(run.time, run.angle - run.reference, label=label, **line)
            states = states_on(rig_of(scenario, SEEDED, 1), scenario)
            times = np.array([state.time for state in states])
            reference = np.interp(times, run.time, run.reference)
            rig.plot(times, [state.angle for state in states] - reference, **line)
            reached = [min(farthest(loop.scenario(4, duration, _at(height))), LOST) for height in HEIGHTS]
            heights.plot(
                [100.0 * height for height in HEIGHTS], reached, marker=MARKERS[loop.name], markersize=3.5, **line
            )
        for axes, title in ((model, "the paper's plane"), (rig, "rovers on the rig, seed 1")):
            axes.set(title=title, xlabel="time, s", xlim=(0.0, duration))
        heights.set(
            title="masses above the axis", xlabel="their height, cm", ylabel="farthest robot, m", ylim=(0.0, LOST)
        )
        for axes in figure.axes:
            axes.grid(visible=True)
        model.set_ylabel("error of the angle, rad")
        model.legend()
        _save(figure, file)


def farthest(scenario: PlaneScenario) -> float:
    """Return the largest distance of a robot from the axis in a simulation, m; infinite if that cannot be computed."""
    try:
        return float(np.abs(simulate(scenario).agents.position).max())
    except RunError:
        return inf


def _at(height: float) -> tuple[str, ...]:
    return tuple(f"swarm.agents.{robot}.center_height={height}" for robot in range(4))


def _save(figure: Figure, file: Path) -> None:
    with Image.open(BytesIO(style.rendered(figure, ("png",))["png"])) as drawn:
        drawn.convert("RGB").quantize(SHADES).save(file, optimize=True)
