"""Draw the README's picture of a run from its bag: python docs/figures/run.py RUN_FOLDER [PICTURE]."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.shown.colours import INERTIA, PLANE, REFERENCE, TORQUE
from swarmabs_core.systems.kinds import KINDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from swarmabs_core.arrays import RunArrays

PICTURE = Path(__file__).parents[1] / "images" / "run.png"
SNAPSHOTS = (0.0, 0.5, 2.0, 8.0)
"""Times of the sketches of the plane, s."""
SHOWN = 8.0
"""Duration plotted, s."""
DASHES = ("-", (0, (6, 1.5)), (0, (3, 1.5)), (0, (1, 1)))
"""Of the lines of the robots."""


def _colour(run: RunArrays, column: int) -> str:
    """Return the colour of a robot's kind."""
    return KINDS[run.agents.kind[0, column]].colour


def sketch(axes: Axes, run: RunArrays, time: float) -> None:
    """Draw plane, lanes and robots at a time (s), seen from slightly above."""
    row = int(np.searchsorted(run.time, time))
    angle = run.angle[row]
    along, upright = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    lane = np.array([0.018, 0.036])  # from one lane to the next
    axes.fill([0.02, -0.03, 0.07], [0.0, -0.1, -0.1], color="#999999")
    corners = [-0.5 * along, 0.5 * along, 0.5 * along + 4 * lane, -0.5 * along + 4 * lane]
    axes.fill(*np.transpose(corners), facecolor="#f4f4f4", edgecolor=REFERENCE, linewidth=1.2, joinstyle="round")
    for number in range(1, 4):
        axes.plot(
            *np.transpose([corners[0] + number * lane, corners[1] + number * lane]), color="#cccccc", linewidth=0.8
        )
    axes.plot(*np.transpose([np.zeros(2), 4 * lane]), color=REFERENCE, linewidth=0.8, linestyle=(0, (3, 2)))
    for column in reversed(range(4)):  # back to front
        radius = 0.045 * np.cbrt(run.agents.mass[row, column] / 0.5)
        foot = run.agents.position[row, column] * along + (column + 0.5) * lane
        centre = foot + radius * upright
        turn = np.linspace(0.0, 2.0 * np.pi, 60)
        outline = centre[:, None] + radius * np.array([np.cos(turn), np.sin(turn)])
        axes.fill(*outline, facecolor=_colour(run, column), edgecolor=REFERENCE, linewidth=0.8)
        name = str(run.agents.ids[column])
        axes.text(centre[0], centre[1], name, fontsize=7, ha="center", va="center_baseline", color=REFERENCE)
    axes.set(xlim=(-0.53, 0.6), ylim=(-0.12, 0.27), aspect="equal")
    axes.axis("off")
    axes.set_title(f"t = {time:g} s, {1000.0 * angle:+.0f} mrad", fontsize=9)


def draw(run: RunArrays) -> Figure:
    """Return the picture."""
    figure = Figure(figsize=(8.4, 6.3), dpi=160, layout="constrained")
    top, bottom = figure.subfigures(2, 1, squeeze=False, height_ratios=(1.0, 4.8))[:, 0]
    for axes, moment in zip(top.subplots(1, len(SNAPSHOTS), squeeze=False)[0], SNAPSHOTS, strict=True):
        sketch(axes, run, moment)
    angle, positions, error = bottom.subplots(3, 1, sharex=True)
    shown = run.time <= SHOWN
    time = run.time[shown]

    angle.axhspan(-10.0, 10.0, color="#dddddd", label="within 10 mrad")
    angle.plot(time, 1000.0 * run.angle[shown], color=PLANE, label="angle of the plane")
    angle.set_ylabel("angle, mrad")
    angle.legend(loc="upper right", frameon=False)

    for column, dashes in enumerate(DASHES):
        label = f"robot {run.agents.ids[column]} ({KINDS[run.agents.kind[0, column]].short})"
        positions.plot(
            time, run.agents.position[shown, column], color=_colour(run, column), linestyle=dashes, label=label
        )
    positions.set_ylabel("position, m")
    positions.legend(loc="center right", ncols=2, frameon=False)

    torque = run.desired.torque - run.abstract.torque
    inertia = run.desired.inertia - run.abstract.inertia
    (first,) = error.plot(time, torque[shown], color=TORQUE, label="torque, left axis")
    other = error.twinx()
    (second,) = other.plot(
        time, 1000.0 * inertia[shown], color=INERTIA, linestyle=(0, (4, 1.5)), label="inertia, right axis"
    )
    limit = 1.15 * np.abs(torque[shown]).max()
    error.set(ylim=(-limit, limit), ylabel="error of the\ntorque, N m", xlabel="time, s", xlim=(-0.05, SHOWN))
    limit = 1.15e3 * np.abs(inertia[shown]).max()
    other.set(ylim=(-limit, limit), ylabel="error of the\ninertia, 10⁻³ kg m²")
    error.legend(handles=[first, second], loc="upper right", frameon=False)
    for axes in (angle, positions, error):
        axes.grid(color="#eeeeee")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    other.spines["top"].set_visible(False)
    bottom.align_ylabels((angle, positions, error))
    return figure


def main(arguments: list[str]) -> int:
    """Read the bag and write the picture."""
    if len(arguments) not in {1, 2}:
        sys.stderr.write(f"{__doc__}\n")
        return 2
    picture = Path(arguments[1]) if len(arguments) > 1 else PICTURE
    draw(load_arrays(arguments[0])).savefig(picture, facecolor="white", metadata={"Software": None})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
