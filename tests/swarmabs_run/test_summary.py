"""What a run comes to, in numbers that JSON has."""

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from swarmabs_bag.run.figures import Tracking
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


def summary(figures: dict[str, Any] | None = None, times: Times = TIMES, **changes: Any) -> dict[str, Any]:
    options: dict[str, Any] = {"status": "ok", "reason": None, "start_seconds": 1.0, "stepping_seconds": 5.0}
    outcome = Outcome(figures=FIGURES if figures is None else figures, **options | changes)
    return summarise(find_scenario("pd_het_4"), outcome, times)


@pytest.mark.parametrize(
    ("changes", "unknown"),
    [
        ({"figures": {}}, FIGURES),
        ({"status": "failed", "reason": "agent 3 is dead"}, {"real_time_factor"}),
        ({"stepping_seconds": 0.0}, {"real_time_factor"}),
        ({"stepping_seconds": None}, {"real_time_factor", "run_time"}),
    ],
)
def test_what_is_not_known_is_null(changes: dict[str, Any], unknown: set[str]) -> None:
    partial, complete = summary(**changes), summary()
    sizes = {"scenario": "pd_het_4", "steps": 3000, "duration": 30.0, "agents": 4}
    times = {"wall_time": 6.543, "real_time_factor": 6.0, "status": "ok"}
    assert (FIGURES | sizes | times).items() <= complete.items()
    assert json.loads(json.dumps(partial, allow_nan=False)).keys() == complete.keys()
    assert {name for name in partial if partial[name] is None} - {"startup_time", "reason", "rerun_of"} == set(unknown)


def test_packed_messages_are_told_and_single_ones_taken_for_granted(tmp_path: Path) -> None:
    assert summary(packed=True) == summary() | {"packed": True}
    assert "--no-packed" in shown(summary(packed=True), tmp_path)
    assert "--no-packed" not in shown(summary(), tmp_path)


def shown(content: dict[str, Any], folder: Path) -> str:
    told = io.StringIO()
    Console(width=300, file=told).print(summary_table(content, RunFolder(folder)))
    return told.getvalue()


def test_no_digest_is_torn_on_a_narrow_terminal(tmp_path: Path) -> None:
    told = io.StringIO()
    tracking = Tracking((0,), (0.02,), "z", "m", "coordinate", "")
    content = summary() | {"digest": "0123456789abcdef" * 4, "events": ["one", "two"]}
    Console(width=70, file=told, soft_wrap=True).print(summary_table(content, RunFolder(tmp_path), tracking))
    lines = told.getvalue().splitlines()
    assert f"digest            {content['digest']}" in lines
    assert lines[lines.index("events            one") + 1] == "                  two"


def test_the_table_of_another_parent_has_its_tolerances_and_its_unit(tmp_path: Path) -> None:
    told = io.StringIO()
    tracking = Tracking((0, 2), (0.02, 0.05), "z", "m", "coordinate", "")
    Console(width=300, file=told).print(summary_table(summary(), RunFolder(tmp_path), tracking))
    text = re.sub(r" +", " ", told.getvalue())
    assert "settled within 0.02, 0.05 m from t = " in text and " rad" not in text
    untracked = io.StringIO()
    Console(width=300, file=untracked).print(
        summary_table(summary(), RunFolder(tmp_path), Tracking((), (), "x", "", "y", ""))
    )
    assert re.search(r"settled|error", untracked.getvalue()) is None, "nothing follows a reference"
    assert re.search(r"max \|coordinate\| \S+ *\n", text), "coordinates may have different units"


def rows_of(text: str) -> dict[str, str]:
    rows = (re.split(r" {2,}|(?<=max \|position\|) ", line.strip(), maxsplit=1) for line in text.splitlines())
    return {row[0]: row[-1] for row in rows}


STEPPED = "run 5.0 s, 6.0 x real time"
NEVER_STEPPED = {"status": "failed", "reason": "no", "stepping_seconds": None}


@pytest.mark.parametrize(
    ("times", "changes", "words"),
    [
        (Times(94.21, setup=85.06, startup=2.34), {}, f"9.1 s: start 2.3 s, {STEPPED}\n"),
        (Times(7.5, setup=0.02, startup=2.34), {}, f"7.5 s: start 2.3 s, {STEPPED}\n"),
        (Times(3.21), NEVER_STEPPED, "3.2 s\n"),
    ],
)
def test_known_times_are_told_apart(tmp_path: Path, times: Times, changes: dict[str, Any], words: str) -> None:
    content = summary(times=times, **changes)
    assert (content["wall_time"], content["setup_time"], content["startup_time"]) == (
        times.wall,
        times.setup,
        times.startup,
    )
    assert content["run_time"] == changes.get("stepping_seconds", 5.0)
    assert f"wall time       {words}" in re.sub(r" +\n", "\n", shown(content, tmp_path))


REALTIME = {
    "missed_periods": {"agent_001": 0, "plane_sim": 3},
    "longest_us": {"agent_001": 1200, "plane_sim": 4300},
    "losses": {"plane/state": {"missing": 0}, "swarm/agent_state": {"missing": 7}},
    "broadcast_ages": {"1": 50, "2": 4, "3": 3, "4": 2, "9": 1},
    "safe_stops": 2,
    "died": {"agent_001": "was killed by SIGKILL"},
}


SHOWN = {
    "missed periods": "plane_sim 3",
    "latest step": "4.3 ms late",
    "missing messages": "swarm/agent_state 7",
    "broadcasts used": "50 after 1 steps, 4 after 2 steps, 3 after 3 steps, 3 after up to 9 steps",
    "safe stops": "2",
    "died": "agent_001 was killed by SIGKILL",
}
NONE_SHOWN = {"missed periods": "none", "latest step": "-", "missing messages": "none", "safe stops": "0"}


@pytest.mark.parametrize(("realtime", "rows"), [(REALTIME, SHOWN), ({}, NONE_SHOWN)])
def test_a_run_in_real_time_has_no_digest(tmp_path: Path, realtime: dict[str, Any], rows: dict[str, str]) -> None:
    content = summary({**FIGURES, "realtime": realtime})
    assert content["realtime"] == realtime
    told = rows_of(shown(content, tmp_path))
    assert rows.items() <= told.items()
    assert "digest" not in told and ("died" in told) is ("died" in realtime)


def test_what_is_run_again_says_what_came_of_it(tmp_path: Path) -> None:
    for same, compared, words in (
        (True, {"compared": "whole"}, "b: same digest"),
        (True, {"compared": "prefix", "last_step": 7}, "b: same digest up to its last step, 7"),
        (False, {"compared": "prefix"}, "b: different digest"),
        (None, {"compared": "whole"}, "b: digests not comparable"),
    ):
        content = {**summary(), "rerun_of": {"bag": "b", "same": same, **compared}}
        assert rows_of(shown(content, tmp_path))["rerun of"] == words


@pytest.mark.parametrize("figures", [FIGURES, {}, {**FIGURES, "settled_at": None}, {**FIGURES, "settled_at": 0.0}])
def test_the_table_shows_it_all(figures: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / "[bold]x[/bold]" / "bag").mkdir(parents=True)  # as the markup of the terminal library
    folder = tmp_path / "[bold]x[/bold]"
    told = rows_of(shown(summary(figures), folder))
    assert "bag" not in told and "rerun of" not in told
    (folder / "bag" / "metadata.yaml").touch()
    assert rows_of(shown(summary(figures), folder))["bag"] == str(folder / "bag")
    assert told["scenario"] == "pd_het_4, 4 robots, 3000 steps"
    assert (told["folder"], told["status"]) == (str(folder), "ok")
    settled = figures.get("settled_at")
    assert told["settled"] == ("not within 0.01 rad" if settled is None else f"within 0.01 rad from t = {settled:g} s")
    assert told["digest"] == (figures["digest"] if figures else "-")
    assert told["max |position|"] == ("0.14 m" if figures else "-")
    assert told["messages"] == ("24008" if figures else "0")
