"""Draw the picture of docs/explanation/cascade.md from the bags of two cascades.

Usage: python docs/figures/cascade.py FOLDER SLOW_FOLDER [PICTURE]. The folders are results of
examples/cascade/cascade.py, the second one with --bandwidth 4.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from swarmabs_analysis.figures.style import ROBOT_DASHES
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.shown.colours import PLANE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE = Path(__file__).parents[1] / "images" / "cascade.png"
SHOWN = 12.0
"""Duration plotted, s."""


def draw(folder: Path, angle: Axes, tilts: Axes, errors: Axes) -> None:
    """Draw a cascade in a column of the figure."""
    coupling = json.loads((folder / "coupling.json").read_text(encoding="utf-8"))
    upper = load_arrays(folder / "upper", namespace="/upper")
    shown = upper.time <= SHOWN
    time = upper.time[shown]
    angle.axhspan(-20.0, 20.0, color="#dddddd", label="within 20 mrad")
    angle.plot(time, 1000.0 * upper.angle[shown], color=PLANE, label="upper plane")
    angle.set_title(f"lower references with {coupling['bandwidth']:g} rad/s", fontsize=10)
    for column, (robot, dashes) in enumerate(zip(upper.agents.ids, ROBOT_DASHES, strict=False)):
        plane = load_arrays(folder / f"lower_{robot}", namespace=f"/lower_{robot}")
        reference = upper.agents.command[:, column] / coupling["ratio"]
        label = f"lower plane {robot}"
        tilts.plot(time, 1000.0 * plane.angle[shown], color=PLANE, linestyle=dashes, label=label)
        errors.plot(time, 1000.0 * (reference - plane.angle)[shown], color=PLANE, linestyle=dashes, label=label)
    errors.set(xlabel="time, s", xlim=(-0.05, SHOWN), xticks=np.arange(0.0, SHOWN + 1.0, 2.0))


def main(arguments: list[str]) -> int:
    """Read the bags and write the picture."""
    if len(arguments) not in {2, 3}:
        sys.stderr.write(f"{__doc__}\n")
        return 2
    picture = Path(arguments[2]) if len(arguments) > 2 else PICTURE
    figure = Figure(figsize=(8.4, 6.0), dpi=130, layout="constrained")
    grid = figure.subplots(3, 2, sharex=True, sharey="row")
    for column, folder in enumerate(arguments[:2]):
        draw(Path(folder), *grid[:, column])
    for axes, label in zip(
        grid[:, 0],
        (
            "angle of the\nupper plane, mrad",
            "angle of the\nlower planes, mrad",
            "reference minus angle\nof lower planes, mrad",
        ),
        strict=True,
    ):
        axes.set_ylabel(label)
    grid[0, 0].legend(loc="upper right", frameon=False)
    grid[1, 0].legend(loc="upper right", frameon=False)
    grid[0, 0].set_ylim(-500.0, 500.0)
    for axes in grid.flat:
        axes.grid(color="#eeeeee")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    figure.align_ylabels(grid[:, 0])
    figure.savefig(picture, facecolor="white", metadata={"Software": None})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
