"""Draw the pictures of docs/how-to/figures.md from runs of the paper: python docs/figures/paper.py RUNS [FOLDER]."""

from __future__ import annotations

import sys
from pathlib import Path

from swarmabs_analysis.figures import FIGURES
from swarmabs_analysis.figures.runs import find_runs
from swarmabs_analysis.figures.style import styled

IMAGES = Path(__file__).parents[1] / "images"
DPI = 150
"""Resolution for a screen; `swarm figures` draws for print."""


def main(arguments: list[str]) -> int:
    """Read the bags and write the pictures."""
    if len(arguments) not in {1, 2}:
        sys.stderr.write(f"{__doc__}\n")
        return 2
    folder = Path(arguments[1]) if len(arguments) > 1 else IMAGES
    sources = find_runs([Path(arguments[0])], [name for figure in FIGURES.values() for name in figure.scenarios])
    for name, figure in FIGURES.items():
        runs = [sources[scenario].load() for scenario in figure.scenarios]
        with styled():
            figure.draw(runs).savefig(folder / f"{name}.png", dpi=DPI, metadata={"Software": None})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
