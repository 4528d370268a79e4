"""The style of the figures, similar to that of the paper for comparison, and their conversion to files.

The colours are those of Okabe and Ito, distinct with any colour vision; each has its own dash pattern, so that prints
in greyscale are legible. Figures have their printed size: one or two columns of the IEEE Transactions, with text of at
least 7 pt. No text is set as mathematics, which would make it smaller and split it into letters.
"""

from __future__ import annotations

import io
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import matplotlib.style

from swarmabs_bag.shown import colours
from swarmabs_core.systems.kinds import DOUBLE_INTEGRATOR, SINGLE_INTEGRATOR

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from matplotlib.figure import Figure

Format = Literal["png", "svg"]
FORMATS: tuple[Format, ...] = ("png", "svg")

COLUMN, PAGE = 3.5, 7.16
"""Width of a column and of a page of two, inches."""

BLACK, GREY, LIGHT = "#000000", "#767676", "#f0f0f0"
ORANGE, SKY, GREEN, YELLOW = DOUBLE_INTEGRATOR.colour, SINGLE_INTEGRATOR.colour, colours.TORQUE, colours.SAFE_STOP
BLUE, VERMILION, PURPLE = colours.PLANE, colours.ERROR, colours.INERTIA

SOLID, DASHED, DOTTED = "-", (0, (4, 1.5)), (0, (1, 1.5))
ROBOT_DASHES: tuple[Literal["-"] | tuple[float, Sequence[float]], ...] = (
    "-",
    (0, (6, 1.2)),
    (0, (3, 1.2)),
    (0, (1, 1)),
)
"""Dashes of the first, second, third and fourth robot; the colour is that of its kind."""

_SHEET = Path(__file__).with_name("paper.mplstyle")
_METADATA: dict[Format, dict[str, None]] = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}


@contextmanager
def styled(more: Mapping[str, float] | None = None) -> Iterator[None]:
    """Draw in the style of the figures, with `more` settings, inside the block; ignores the user's matplotlibrc."""
    with matplotlib.style.context(["default", _SHEET, dict(more or {})]):
        yield


def rendered(
    figure: Figure,
    formats: Sequence[Format],
    title: str | None = None,
    finish: Callable[[Figure], None] = lambda _: None,
) -> dict[Format, bytes]:
    """Return a figure as file contents, optionally with a title in their metadata; call it inside `styled`.

    `finish` may change what is drawn when its layout and limits are final.
    """
    # Laid out once, because each format measures text differently.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    finish(figure)
    files: dict[Format, bytes] = {}
    for kind in formats:
        file = io.BytesIO()
        figure.savefig(file, format=kind, metadata=_METADATA[kind] | ({"Title": title} if title else {}))
        files[kind] = file.getvalue()
    return files
