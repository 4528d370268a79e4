"""What a run comes to, in numbers that JSON has."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from swarmabs_bag.run_folder import RunFolder
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.run import Outcome
from swarmabs_run.summary import Times, summarise, summary_table

FIGURES = {
    "settled_at": 4.5,
    "final_error": -1e-4,
    "rms_error": 0.02,
    "max_abs_position": 0.14,
    "messages": 24008,
    "digest": "ab" * 32,
}
TIMES = Times(6.54321)
KEYS = {
    *("scenario", "steps", "duration", "wall_time", "real_time_factor", "agents", "settled_at", "final_error"),
    *("rms_error", "max_abs_position", "messages", "digest", "status", "setup_time", "startup_time", "run_time"),
}


def summary(figures: dict[str, Any] | None = None, times: Times = TIMES, **changes: Any) -> dict[str, Any]:
    options: dict[str, Any] = {"status": "ok", "reason": None, "start_seconds": 1.0, "stepping_seconds": 5.0}
    outcome = Outcome(figures=FIGURES if figures is None else figures, **options | changes)
    return summarise(find_scenario("pd_het_4"), outcome, times)


def test_a_complete_run() -> None:
    found = summary()
    assert found.keys() >= KEYS
    assert FIGURES.items() <= found.items()
    assert (found["scenario"], found["steps"], found["duration"], found["agents"]) == ("pd_het_4", 3000, 30.0, 4)
    assert (found["wall_time"], found["real_time_factor"], found["status"]) == (6.543, 6.0, "ok")


@pytest.mark.parametrize(
    "changes",
    [
        {"figures": {}},
        {"status": "failed", "reason": "agent 3 is dead"},
        {"status": "interrupted", "stepping_seconds": None},
        {"stepping_seconds": 0.0},
        {"stepping_seconds": None},
    ],
)
def test_what_is_not_known_is_null(changes: dict[str, Any]) -> None:
    found = summary(**changes)
    text = json.dumps(found, allow_nan=False)
    assert json.loads(text).keys() >= KEYS
    if "status" in changes or "stepping_seconds" in changes:
        assert found["real_time_factor"] is None
    if "figures" in changes:
        assert all(found[name] is None for name in FIGURES)


def shown(found: dict[str, Any], folder: Path) -> str:
    console = Console(width=200, record=True, file=(folder / "out").open("w"), force_terminal=False)
    with console.file:
        console.print(summary_table(found, RunFolder(folder)))
        return console.export_text()


def test_set_up_start_and_run_are_told_apart(tmp_path: Path) -> None:
    found = summary(times=Times(94.21, setup=85.06, startup=2.34))
    assert [found[name] for name in ("wall_time", "setup_time", "startup_time", "run_time")] == [
        94.21,
        85.06,
        2.34,
        5.0,
    ]
    assert "94.2 s: set-up 85.1 s, start 2.3 s, run 5.0 s, 6.0 x real time" in shown(found, tmp_path)


def test_a_set_up_that_was_there_is_not_shown(tmp_path: Path) -> None:
    text = shown(summary(times=Times(7.5, setup=0.02, startup=2.34)), tmp_path)
    assert "7.5 s: start 2.3 s, run 5.0 s" in text
    assert "set-up" not in text


def test_of_a_run_that_never_stepped_the_whole_time_is_shown(tmp_path: Path) -> None:
    found = summary({}, times=Times(3.21), status="failed", reason="no", stepping_seconds=None)
    assert (found["startup_time"], found["run_time"]) == (None, None)
    assert "wall time       3.2 s\n" in re.sub(r" +\n", "\n", shown(found, tmp_path))


@pytest.mark.parametrize("figures", [FIGURES, {}, {**FIGURES, "settled_at": None}, {**FIGURES, "settled_at": 0.0}])
def test_the_table_shows_it_all(figures: dict[str, Any], tmp_path: Path) -> None:
    text = shown(summary(figures), tmp_path)
    assert "pd_het_4, 4 robots, 3000 steps" in text
    assert str(tmp_path) in text
    assert "None" not in text
    if figures:
        assert figures["digest"] in text
    settled = figures.get("settled_at")
    assert ("not within 0.01 rad" if settled is None else f"from t = {settled:g} s") in text


def test_the_table_takes_a_name_as_it_is(tmp_path: Path) -> None:
    """A folder that looks like the markup of the terminal library."""
    folder = tmp_path / "[bold]x[/bold]"
    console = Console(width=300, record=True, quiet=True)
    console.quiet = False
    with (tmp_path / "out").open("w") as stream:
        console.file = stream
        console.print(summary_table(summary(), RunFolder(folder)))
        assert "[bold]x[/bold]" in console.export_text()
