"""Draw a picture of the gallery from the bag of a run: python docs/figures/gallery.py RUN_FOLDER PICTURE.

It shows the angle with its reference, the torque of the swarm with the desired one, and the positions of the robots.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.shown.colours import PLANE, REFERENCE, TORQUE
from swarmabs_core.systems.kinds import KINDS


def draw(folder: Path, picture: Path) -> None:
    """Draw a run on the plane."""
    run = load_arrays(folder)
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    angle, torque, position = figure.subplots(3, sharex=True)
    angle.plot(run.time, run.reference, color=REFERENCE, linestyle="--", label="reference")
    angle.plot(run.time, run.angle, color=PLANE, label="plane")
    torque.plot(run.time, run.desired.torque, color=REFERENCE, linestyle="--", label="desired")
    torque.plot(run.time, run.abstract.torque, color=TORQUE, label="swarm")
    for column in range(len(run.agents.ids)):
        kinds = run.agents.kind[:, column]
        kind = KINDS[kinds[np.flatnonzero(kinds)[0]]]
        position.plot(run.time, run.agents.position[:, column], color=kind.colour, linewidth=1.0)
    for axes, name in ((angle, "angle [rad]"), (torque, "torque [N m]"), (position, "robots [m]")):
        axes.set_ylabel(name)
        axes.grid(color="#dddddd", linewidth=0.5)
    angle.legend(loc="upper right", fontsize=8)
    torque.legend(loc="upper right", fontsize=8)
    position.set_xlabel("time [s]")
    figure.savefig(picture, dpi=100)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit("error: give the folder of a run and the picture to write")
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
