"""The figures of the paper, drawn from recorded runs and from the geometry of the abstraction.

A figure is named by its label in the paper's source.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from swarmabs_analysis.figures.abstract_space import draw_mapping_example, draw_position_mapping
from swarmabs_analysis.figures.responses import draw_large_swarms, draw_three_swarms
from swarmabs_analysis.figures.style import rendered, styled

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.figure import Figure

    from swarmabs_analysis.figures.runs import CompleteBag, RecordedRun
    from swarmabs_analysis.figures.style import Format


class PaperFigure(NamedTuple):
    """A figure: the scenarios whose runs it shows, and the function that draws these runs in this order."""

    scenarios: tuple[str, ...]
    draw: Callable[[Sequence[RecordedRun]], Figure]


FIGURES: Mapping[str, PaperFigure] = {
    "mappingEx": PaperFigure((), lambda _: draw_mapping_example()),
    "posMapping": PaperFigure((), lambda _: draw_position_mapping()),
    "PD_res": PaperFigure(("pd_si_4", "pd_di_4", "pd_het_4"), draw_three_swarms),
    "ARISE_res": PaperFigure(("arise_si_4", "arise_di_4", "arise_het_4"), draw_three_swarms),
    "ARISE_lg_swarm": PaperFigure(("arise_het_20", "arise_het_200"), draw_large_swarms),
}
"""The figures by their labels in the paper's source, without ``fig:``."""


def draw_files(name: str, bags: Mapping[str, CompleteBag], formats: Sequence[Format]) -> dict[str, bytes]:
    """Draw one of `FIGURES` and return its files by name.

    Parameters
    ----------
    bags : mapping
        The bags of its scenarios, by name of the scenario; others are ignored.

    Raises
    ------
    DamagedBagError
        If a bag is damaged.
    """
    chosen = FIGURES[name]
    runs = [bags[scenario].load() for scenario in chosen.scenarios]
    with styled():
        figure = chosen.draw(runs)
        return {f"{name}.{kind}": content for kind, content in rendered(figure, formats).items()}
