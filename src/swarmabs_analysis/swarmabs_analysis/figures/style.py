"""How the figures of the paper look, which keep its look for comparison, and how pictures become files.

Okabe and Ito's colours, which people with any colour vision tell apart, and with each colour a dash pattern of its own,
so that grey prints do as well. Sizes are those at which the figures are printed: one or two columns of IEEE's
transactions, the smallest text 7 pt. No text is set as mathematics, which would make it smaller and tear it to letters.
"""

from __future__ import annotations

import io
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import matplotlib.style

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.figure import Figure

Format = Literal["png", "svg"]
FORMATS: tuple[Format, ...] = ("png", "svg")

COLUMN, PAGE = 3.5, 7.16
"""Width of a column and of a page of two, inches."""

BLACK, GREY, LIGHT = "#000000", "#767676", "#f0f0f0"
ORANGE, SKY, GREEN, YELLOW = "#e69f00", "#56b4e9", "#009e73", "#f0e442"
BLUE, VERMILION, PURPLE = "#0072b2", "#d55e00", "#cc79a7"

SOLID, DASHED, DOTTED = "-", (0, (4, 1.5)), (0, (1, 1.5))
ROBOTS = ((ORANGE, SOLID), (SKY, (0, (6, 1.2))), (GREEN, (0, (3, 1.2))), (PURPLE, (0, (1, 1))))
"""Colour and dashes of the first, second, third and fourth robot."""

_SHEET = Path(__file__).with_name("paper.mplstyle")
_METADATA: dict[Format, dict[str, None]] = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}


@contextmanager
def styled(more: Mapping[str, float] | None = None) -> Iterator[None]:
    """Draw in the figures' style and with `more` settings in the block, whatever the user's matplotlibrc says."""
    with matplotlib.style.context(["default", _SHEET, dict(more or {})]):
        yield


def rendered(figure: Figure, formats: Sequence[Format], title: str | None = None) -> dict[Format, bytes]:
    """Return a figure as the contents of files, maybe with a title in their metadata; call it within `styled`."""
    # Laid out once: each format measures text in its own way, and would move what another one has placed.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    found: dict[Format, bytes] = {}
    for kind in formats:
        file = io.BytesIO()
        figure.savefig(file, format=kind, metadata=_METADATA[kind] | ({"Title": title} if title else {}))
        found[kind] = file.getvalue()
    return found
