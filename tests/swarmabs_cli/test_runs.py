"""What of the wall time was set-up, as ``scripts/swarm`` hands it over."""

from __future__ import annotations

import os

import pytest

from swarmabs_cli.runs import SETUP, setup_seconds, since_start, times
from swarmabs_run.run import Outcome


@pytest.mark.parametrize(("told", "seconds"), [("{own}:85.25", 85.25), ("{parent}:85.25", 0.0), ("", 0.0), (None, 0.0)])
def test_only_the_process_that_was_set_up_counts_it(
    monkeypatch: pytest.MonkeyPatch, told: str | None, seconds: float
) -> None:
    monkeypatch.delenv(SETUP, raising=False)
    if told is not None:
        monkeypatch.setenv(SETUP, told.format(own=os.getpid(), parent=os.getppid()))
    assert setup_seconds() == seconds


def test_start_is_what_lies_between_set_up_and_the_first_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SETUP, f"{os.getpid()}:85.25")
    assert times(86.0, Outcome("ok", None, {}, start_seconds=1.5)).startup == pytest.approx(2.25)
    assert times(86.0, Outcome("failed", "no", {})).startup is None


def test_the_clock_runs_since_the_process_was_started() -> None:
    assert 0.0 < since_start() < 3600.0
