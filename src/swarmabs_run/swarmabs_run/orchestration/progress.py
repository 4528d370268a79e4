"""What is told of a run while it goes on, and how it ended: the same for every way of running."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from swarmabs_bag.recorder.swarm_summary import SwarmSummary

Phase = Literal["starting", "running", "closing"]


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is.

    Parameters
    ----------
    phase : str
        ``starting``, ``running`` or ``closing``.
    ready, processes : int
        How many processes are ready, and how many there are.
    step, steps : int
        Steps recorded, and steps in all.
    step_rate : float
        Steps per second of wall time since the start.
    angle, error : float, optional
        Of the latest step recorded, rad.
    robots : SwarmSummary, optional
        The robots in that step, and what has happened.
    """

    phase: Phase
    ready: int
    processes: int
    step: int
    steps: int
    step_rate: float = 0.0
    angle: float | None = None
    error: float | None = None
    robots: SwarmSummary | None = None


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended.

    Parameters
    ----------
    status : str
        ``ok``, ``failed`` or ``interrupted``.
    reason : str, optional
        What went wrong; may have several lines, the last ones of logs.
    figures : dict
        Digest and figures, as far as they were recorded.
    start_seconds, stepping_seconds : float, optional
        Wall time until the first step, and from it to the last, s.
    warnings : tuple of str
        What people should know of a run that did not fail.
    """

    status: Literal["ok", "failed", "interrupted"]
    reason: str | None
    figures: dict[str, Any]
    start_seconds: float | None = None
    stepping_seconds: float | None = None
    warnings: tuple[str, ...] = ()
