"""How a run is asked for, how far it is while it goes on, and how it ended: the same for every way of running."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from swarmabs_bag.run_folder import ONE_FILE, Split

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bag.recorder.swarm_summary import SwarmSummary

Phase = Literal["starting", "running", "closing"]


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a run is.

    Parameters
    ----------
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
class RunOptions:
    """How a scenario is run.

    A simulation in one process reads only the first three; a run in real time, those from `agents_per_process` on not.

    Parameters
    ----------
    record : bool
        Whether to write a bag.
    split : Split
        When the bag continues in a new file.
    on_progress : callable, optional
        Told how the run goes, some ten times a second.
    namespace : str
        ROS namespace of the swarm.
    agents_per_process : int
        How many robots share a process.
    packed : bool
        Whether the robots hear the three broadcasts as one message, which costs less where they are many.
    steered : bool
        Whether the run can be steered, by a socket in its folder.
    step_seconds : float
        Shortest wall time, s, of a step of such a run; 0: as fast as possible.
    """

    record: bool = True
    split: Split = ONE_FILE
    on_progress: Callable[[Progress], None] | None = None
    namespace: str = "/"
    agents_per_process: int = 1
    packed: bool = False
    steered: bool = False
    step_seconds: float = 0.0


DEFAULTS = RunOptions()
SLOWEST_STEP = 1.0
"""Longest that `RunOptions.step_seconds` may be, s: shorter than any stall."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended.

    Parameters
    ----------
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
