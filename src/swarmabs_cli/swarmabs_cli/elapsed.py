"""How long the user's command has taken so far, and how much of that was its set-up."""

from __future__ import annotations

import os
import time
from pathlib import Path

from swarmabs_run.run import Outcome
from swarmabs_run.summary import Times

SETUP = "SWARMABS_SETUP"
"""Environment variable in which ``scripts/swarm`` says which process it became, and after how many seconds."""


def since_start() -> float:
    """Return the wall time since this process was started, which is when the user's command was, s.

    Of the fields of ``/proc/self/stat`` behind the name, which may itself hold blanks, the twentieth is the start in
    clock ticks since the machine was.
    """
    stat = Path("/proc/self/stat").read_text(encoding="utf-8", errors="replace")
    ticks = int(stat.rpartition(")")[2].split()[19])
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


def setup_seconds() -> float:
    """Return how much of `since_start` was the set-up of the checkout, s; commands that this one starts had none."""
    pid, _, seconds = os.environ.get(SETUP, "").partition(":")
    return float(seconds) if pid == str(os.getpid()) else 0.0


def times(loading: float, outcome: Outcome) -> Times:
    """Return what has taken how long.

    Parameters
    ----------
    loading : float
        What `since_start` was when the run was begun, s.
    outcome : Outcome
        How the run ended.
    """
    setup, start = setup_seconds(), outcome.start_seconds
    return Times(since_start(), setup, None if start is None else loading - setup + start)
