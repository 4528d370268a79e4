"""Draw the architecture and the data of one step: python docs/figures/architecture.py [PICTURE]."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from swarmabs_analysis.figures.style import BLACK, BLUE, GREEN, GREY, VERMILION

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE = Path(__file__).parents[1] / "images" / "architecture.svg"


class Box(NamedTuple):
    """A process: lower left corner, size, name and description."""

    x: float
    y: float
    width: float
    height: float
    name: str
    text: str
    colour: str = BLACK


BOXES = (
    Box(-0.15, 1.5, 2.8, 2.2, "agent_001 ... agent_NNN", "one process per robot:\nlaw, drive, own state", VERMILION),
    Box(4.7, 4.0, 2.5, 1.2, "abstraction_observer", "sums over the swarm,\nmembership"),
    Box(4.7, 0.0, 2.5, 1.2, "plane_sim", "the plane (an encoder\non hardware)"),
    Box(9.4, 0.0, 2.5, 1.2, "parent_controller", "PD, LQR, PID, ARISE,\nfilter, manifold"),
    Box(4.7, 2.0, 2.5, 1.2, "recorder", "orders, checks and\nwrites the bag", GREY),
)


def box(axes: Axes, shape: Box) -> None:
    """Draw a process."""
    patch = FancyBboxPatch(
        (shape.x, shape.y),
        shape.width,
        shape.height,
        boxstyle="round,pad=0,rounding_size=0.12",
        facecolor="white",
        edgecolor=shape.colour,
        linewidth=1.8,
        linestyle="--" if shape.colour == GREY else "-",
    )
    axes.add_patch(patch)
    middle = shape.x + shape.width / 2.0
    top = shape.y + shape.height / 2.0
    axes.text(middle, top + 0.14, shape.name, ha="center", va="bottom", fontsize=10, weight="bold", color=shape.colour)
    axes.text(middle, top + 0.04, shape.text, ha="center", va="top", fontsize=9)


def arrow(axes: Axes, points: list[tuple[float, float]], colour: str, dashed: bool = False) -> None:  # noqa: FBT001, FBT002
    """Draw a line with an arrow head at its end."""
    style = (0, (4, 2)) if dashed else "-"
    if len(points) > 2:
        axes.plot(*zip(*points[:-1], strict=True), color=colour, linewidth=1.6, linestyle=style, solid_capstyle="round")
    axes.add_patch(
        FancyArrowPatch(
            *points[-2:],
            arrowstyle="-|>",
            mutation_scale=13,
            shrinkA=0.0,
            shrinkB=0.0,
            color=colour,
            linewidth=1.6,
            linestyle=style,
        )
    )


def note(axes: Axes, x: float, y: float, text: str, colour: str, align: str = "center") -> None:
    """Label an arrow with its messages."""
    axes.text(x, y, text, ha=align, va="center", fontsize=9, color=colour, linespacing=1.25)


def draw() -> Figure:
    """Return the picture."""
    figure = Figure(figsize=(10.2, 5.6))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-0.3, 12.1), ylim=(-0.95, 5.95), aspect="equal")
    axes.axis("off")
    for shape in BOXES:
        box(axes, shape)
    # Messages published by the robots.
    arrow(axes, [(1.9, 3.7), (1.9, 4.35), (4.7, 4.35)], VERMILION)
    arrow(axes, [(1.25, 1.5), (1.25, 0.6), (4.7, 0.6)], VERMILION)
    note(axes, 3.35, 4.12, "1  AgentState(k)", VERMILION)
    note(axes, 2.95, 0.82, "1  AgentState(k)", VERMILION)
    # Messages received by the robots.
    arrow(axes, [(4.7, 4.85), (0.65, 4.85), (0.65, 3.7)], BLUE)
    note(axes, 2.7, 5.22, "2  AbstractState(k),\nAuxiliaryState(k)", BLUE)
    arrow(axes, [(10.65, 1.2), (10.65, 5.6), (0.25, 5.6), (0.25, 3.7)], BLUE)
    note(axes, 10.55, 3.4, "3  DesiredAbstractState(k)", BLUE, "right")
    # The loop of the parent system.
    arrow(axes, [(7.2, 0.6), (9.4, 0.6)], GREEN)
    note(axes, 8.3, 0.82, "2  PlaneState(k)", GREEN)
    # The recorder.
    arrow(axes, [(7.2, 2.4), (9.9, 2.4), (9.9, 1.2)], GREY, dashed=True)
    note(axes, 8.5, 2.62, "credit: at most 100\nsteps ahead of the bag", GREY)
    arrow(axes, [(3.6, 2.6), (4.7, 2.6)], GREY, dashed=True)
    note(axes, 3.6, 2.95, "all topics", GREY)
    note(
        axes,
        5.95,
        -0.6,
        "4  With the three blue broadcasts of step k a robot computes u(k), moves until k+1, sends AgentState(k+1).",
        BLACK,
    )
    return figure


def main(arguments: list[str]) -> int:
    """Write the picture."""
    picture = Path(arguments[0]) if arguments else PICTURE
    # Reproducible files: no date and no random names.
    with mpl.rc_context({"svg.hashsalt": "swarmabs", "svg.fonttype": "path"}):
        draw().savefig(
            picture, facecolor="white", dpi=110, metadata={"Date": None} if picture.suffix == ".svg" else None
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
