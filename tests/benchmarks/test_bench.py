"""The command `bench`: tiny runs of every suite, with real processes; times are not judged."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from benchmarks.bench import bench
from benchmarks.common import Settings
from benchmarks.floor_programs import FLOORS
from benchmarks.processes import AGENTS
from benchmarks.results import CHART, DOCUMENT, LARGE_CHART, TABLES
from tests.benchmarks.results import document, repeat
from tests.processes import marked_processes, until

from swarmabs_cli import main
from swarmabs_core.errors import InputError

pytestmark = [pytest.mark.system, pytest.mark.full, pytest.mark.timeout(120)]

SPREAD = {"median", "smallest", "largest"}


LARGE = ("--large", "4", "--agents-per-process", "3")


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Carry out a command, which must not fail."""
    words = [sys.executable, "-m", "swarmabs_cli", *arguments]
    return subprocess.run(words, capture_output=True, text=True, check=True)


def measured(folder: Path, suite: str) -> dict[str, Any]:
    """Return the document of a tiny run of a suite."""
    arguments = ["bench", "--suite", suite, "--robots", "4", "--repeat", "1", "--window", "0.6", "--json", *LARGE]
    shown = command(*arguments, "-o", str(folder))
    found: dict[str, Any] = json.loads(shown.stdout)
    assert found == json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))
    assert (folder / TABLES).is_file()
    assert "4 robots" in shown.stderr
    assert found["machine"]["cores"] >= 1
    assert found["settings"]["suites"] == [suite]
    return found


@pytest.mark.usefixtures("nothing_survives")
def test_product_is_measured_beside_all_floors(tmp_path: Path) -> None:
    (row,) = measured(tmp_path, "product")["product"]
    (results,) = row["repeats"]
    assert results.keys() == {*FLOORS, "product", "packed"}
    assert row["summary"]["steps_per_second"].keys() == results.keys()
    assert row["summary"]["ratio_to_floor"].keys() == SPREAD
    assert results["product"]["start_seconds"] > 0.0
    assert (tmp_path / CHART).is_file()


@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize(
    ("suite", "keys"),
    [
        ("start", {"start_seconds", "shut_down_seconds"}),
        ("memory", {"agent_bytes", "total_bytes"}),
        ("large", {"start_seconds", "steps_per_second", "total_bytes", "cpu_ms_per_step"}),
        ("recorder", {"messages_per_second", "core_share", "messages_per_core_second"}),
        ("reading", {"bag_bytes", "arrays_bytes_per_second", "ratio_to_iteration"}),
        ("simulate", {"real_time_factor", "real_time_factor_without_bag"}),
    ],
)
def test_a_suite_gives_a_well_formed_document(tmp_path: Path, suite: str, keys: set[str]) -> None:
    found = measured(tmp_path, suite)
    (row,) = found[suite]
    assert row["robots"] == 4
    assert row["summary"].keys() == keys
    assert all(
        spread is None or (spread.keys() == SPREAD and spread["smallest"] > 0.0) for spread in row["summary"].values()
    )
    if suite == "start":
        assert (row["starts"], row["clean"], row["failures"], row["busy_processes"]) == (1, 1, [], 0)
    if suite == "large":
        assert (row["agents_per_process"], row["failures"]) == (3, [])
        assert (tmp_path / LARGE_CHART).is_file()
    if suite == "memory":
        assert row["repeats"][0]["coordinators"].keys() == {"plane", "observer", "controller", "recorder"}
        assert AGENTS not in row["repeats"][0]["coordinators"]
    if suite == "simulate":
        assert found["solver"]["ratio"].keys() == SPREAD
        assert found["solver"]["repeats"][0]["largest_difference"] < 1e-3


@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize("suite", ["product", "start", "large", "recorder"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_benchmark_leaves_nothing(tmp_path: Path, suite: str, number: signal.Signals) -> None:
    folder = tmp_path / "result"
    arguments = ["--suite", suite, "--robots", "4", "--repeat", "9", "--window", "30", *LARGE, "-o", str(folder)]
    with subprocess.Popen(
        [sys.executable, "-m", "swarmabs_cli", "bench", *arguments], stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        assert "4 robots" in process.stderr.readline()
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(3.0)  # by then its processes are there
        process.send_signal(number)
        _, errors = process.communicate()
    assert process.returncode == 1
    assert "interrupted" in errors
    assert not folder.exists()


@pytest.mark.usefixtures("nothing_survives")
def test_starts_on_a_busy_machine_are_counted(tmp_path: Path) -> None:
    arguments = ["bench", "--suite", "start", "--robots", "4", "--starts", "2", "--busy", "--window", "0.6", "--json"]
    (row,) = json.loads(command(*arguments, "-o", str(tmp_path)).stdout)["start"]
    assert (row["starts"], row["clean"], len(row["repeats"])) == (2, 2, 2)
    assert row["busy_processes"] >= 2


@pytest.mark.parametrize("suite", ["product", "start", "large"])
def test_a_benchmark_that_is_killed_takes_its_processes_with_it(
    nothing_survives: str, tmp_path: Path, suite: str
) -> None:
    """Nobody can tidy up then: the kernel ends what was started."""
    arguments = ["--suite", suite, "--robots", "4", "--repeat", "9", "--window", "30", "--busy", *LARGE]
    with subprocess.Popen(
        [sys.executable, "-m", "swarmabs_cli", "bench", *arguments, "-o", str(tmp_path / "result")],
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},  # its temporary files stay, as those of anything that is killed
    ) as process:
        until(lambda: len(marked_processes(nothing_survives)) > 6, "its processes are there", 60.0)
        process.kill()
        process.wait()
        until(lambda: not marked_processes(nothing_survives), "all processes are gone")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--robots", "4,x"], "'4,x' is not a list such as 4,20"),
        (["--robots", "1"], "a swarm has at least 2 robots"),
        (["--suite", "all the rest"], "is not one of"),
        (["--starts", "0"], "0 is not in the range"),
        (["--large", "1"], "a swarm has at least 2 robots"),
        (["--window", "0"], "0.0 is not in the range"),
    ],
)
def test_bad_arguments_are_refused(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], reason: str
) -> None:
    assert main(["bench", *arguments, "-o", str(tmp_path / "result")]) == 2
    assert reason in capsys.readouterr().err
    assert not (tmp_path / "result").exists()


def test_a_missing_package_is_named_with_its_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.bench.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pyzmq is missing, .*; start with \./scripts/swarm bench"):
        bench(Settings(suites=("product",)), tmp_path / "result", as_json=True)
    assert not (tmp_path / "result").exists()


def test_two_results_are_compared(tmp_path: Path) -> None:
    for name, speed in (("old", 50.0), ("new", 60.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / DOCUMENT).write_text(json.dumps(document(repeat(speed))), encoding="utf-8")
    folders = [str(tmp_path / name) for name in ("old", "new")]
    rows = {row["measure"]: row for row in json.loads(command("bench", "--compare", *folders, "--json").stdout)}
    assert rows["product"]["new/old"] == "1.20"
    assert "1.20" in command("bench", "--compare", *folders).stdout
