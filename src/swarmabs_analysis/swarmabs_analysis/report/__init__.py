"""The report of a run: one self-contained HTML page and an overview as PNG, made from a bag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.report.margins import margins, weights
from swarmabs_analysis.report.page import lowest, page
from swarmabs_analysis.report.panels import panels
from swarmabs_analysis.report.pictures import overview
from swarmabs_analysis.report.record import read_recorded

if TYPE_CHECKING:
    from pathlib import Path

    from swarmabs_analysis.report.margins import Margins
    from swarmabs_analysis.report.record import Recorded


@dataclass(frozen=True, slots=True)
class Report:
    """A report, not written yet.

    Attributes
    ----------
    bag : Path
        The MCAP file.
    html : str
        The page.
    png : bytes
        The overview.
    numbers : dict
        What the page is about, for JSON.
    """

    bag: Path
    html: str
    png: bytes
    numbers: dict[str, Any]


def make_report(path: Path, *, namespace: str | None = None) -> Report:
    """Make the report of a bag: a run's folder, its ``bag/``, or an MCAP file; of several swarms in it, of one.

    Raises
    ------
    InputError
        If it is no bag of a swarm, or holds no valid scenario.
    DamagedBagError
        If it cannot be read.
    """
    recorded = read_recorded(path, namespace=namespace)
    on_plane = weights(recorded)
    margin = margins(recorded, on_plane)
    drawn = list(panels(recorded, on_plane, margin)) if recorded.drawable else []
    return Report(
        recorded.swarm.bag,
        page(recorded, drawn, margin),
        overview(recorded, {panel.key: panel for panel in drawn}),
        _numbers(recorded, margin),
    )


def _numbers(recorded: Recorded, margin: Margins) -> dict[str, Any]:
    return {
        "scenario": recorded.scenario.name,
        "status": recorded.swarm.status,
        "reason": recorded.swarm.reason,
        "agents": len(recorded.arrays.agents.ids),
        "steps": recorded.steps,
        **recorded.metrics,
        "events": len(recorded.swarm.events),
        "margins": {
            "end": lowest(margin.end),
            "abstract_state": lowest(margin.actual),
            "desired_abstract_state": lowest(margin.desired),
            "spread": lowest(margin.spread),
        },
    }
