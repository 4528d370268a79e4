"""Options, progress and outcome of a run, common to all ways of running."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_core.ranges import reason_of, texts_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bag.recorder.swarm_summary import SwarmSummary
    from swarmabs_config.scenario import Scenario

Phase = Literal["starting", "running", "paused", "closing"]
Figures: TypeAlias = dict[str, Any]
"""Digest and figures of a recording, a JSON document."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of a run.

    Parameters
    ----------
    ready, processes : int
        Number of ready processes and of all processes.
    step, steps : int
        Number of recorded steps and of all steps.
    step_rate : float
        Steps per second of wall time since the start.
    angle, error : float, optional
        Angle and error of the latest recorded step, rad.
    robots : SwarmSummary, optional
        The robots in that step, and the latest events.
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
    """Options for running a scenario.

    A simulation in one process uses only the first three; a run in real time ignores `agents_per_process` and the
    options after it.

    Parameters
    ----------
    record : bool
        Whether to write a bag.
    split : Split
        When the bag continues in a new file.
    on_progress : callable, optional
        Called with the progress of the run, about ten times a second.
    namespace : str
        ROS namespace of the swarm.
    agents_per_process : int
        Number of robots per process.
    packed : bool, optional
        Whether the robots receive the three broadcasts as one message, and plane and recorder the robots' states. None:
        if there are at least `PACKED_FROM` robots.
    steered : bool
        Whether the run can be steered through a socket in its folder.
    step_seconds : float
        Shortest wall time, s, of a step of a steered run on average; 0: as fast as possible.
    paused : bool
        Whether a steered run is paused at its first step.
    restarts : bool
        Whether a steered run may be asked to end so that another one starts; its outcome then says so.
    """

    record: bool = True
    split: Split = ONE_FILE
    on_progress: Callable[[Progress], None] | None = None
    namespace: str = "/"
    agents_per_process: int = 1
    packed: bool | None = None
    steered: bool = False
    step_seconds: float = 0.0
    paused: bool = False
    restarts: bool = False

    def packs(self, scenario: Scenario) -> bool:
        """Return whether messages are packed: never where the robots sum up the swarm by themselves."""
        if scenario.decentralised:
            return False
        return len(scenario.agents) >= PACKED_FROM if self.packed is None else self.packed


PACKED_FROM = 8
"""Number of robots from which a run with packed messages is faster."""
DEFAULTS = RunOptions()
SLOWEST_STEP = 1.0
"""Largest `RunOptions.step_seconds`, s: shorter than any stall timeout."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a run.

    Parameters
    ----------
    reason : str, optional
        What went wrong; further lines show the ends of logs.
    figures : Figures
        Digest and figures, as far as they are known.
    start_seconds, stepping_seconds : float, optional
        Wall time to the first step, and from the first to the last step, s.
    warnings : tuple of str
        Warnings about a run that did not fail.
    packed : bool
        Whether messages were packed.
    restart : str, optional
        The request that ended the run so that another one starts, ``restart`` or ``restart_beside``.
    """

    status: Literal["ok", "failed", "interrupted"]
    reason: str | None
    figures: Figures
    start_seconds: float | None = None
    stepping_seconds: float | None = None
    warnings: tuple[str, ...] = ()
    packed: bool = False
    restart: str | None = None

    def judged(self, *, repeats: bool) -> Outcome:
        """Return the outcome by the robots that left their ranges: a complete run has failed if any flew off.

        A run that `repeats` a recorded one has done what was asked, so these robots are only a warning.
        """
        strays = self.figures.get("out_of_range")
        if self.status != "ok" or not strays:
            return self
        if strays["flown_off"] and not repeats:
            return replace(self, status="failed", reason=reason_of(strays))
        return replace(self, warnings=(*self.warnings, *texts_of(strays)))
