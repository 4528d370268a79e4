"""The command `bench`: tiny runs of every suite and baseline, with real processes; times are not judged."""

import ast
import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from benchmarks import baseline_programs
from benchmarks.baseline_programs import BASELINES, FOLDER, Baseline, measure_baseline
from benchmarks.processes import AGENTS
from benchmarks.results import CHART, DOCUMENT, LARGE_CHART, TABLES
from benchmarks.tables import READERS, comparison
from tests.processes import marked_processes, until

from swarmabs_core.errors import RunError

pytestmark = [pytest.mark.system, pytest.mark.full, pytest.mark.timeout(300)]

BENCH = (sys.executable, "-m", "swarmabs_cli", "bench", "--robots", "4", "--large", "4", "--agents-per-process", "3")
BAD = """
import signal, sys
from workers import Workers
sys.exit(Workers().serve({"good": lambda workers: (workers.ready(), signal.pause()), "bad": lambda workers: 1 / 0}))
"""
LATE = """
import sys
from workers import Workers
def late(workers):
    workers.ready()
    raise SystemExit
sys.exit(Workers().serve({"late": late}))
"""
MUTE = "import signal; signal.pause()"
IDLE = BAD.replace('"bad": lambda workers: 1 / 0', "")
SPREAD = {"median", "smallest", "largest"}
MEASURES = {
    "start": {"start_seconds", "shut_down_seconds"},
    "memory": {"agent_bytes", "total_bytes"},
    "large": {"start_seconds", "steps_per_second", "total_bytes", "cpu_ms_per_step"},
    "recorder": {"messages_per_second", "core_share", "messages_per_core_second"},
    "reading": {"bag_bytes", "arrays_bytes_per_second", "ratio_to_iteration", *READERS},
    "simulate": {"real_time_factor", "real_time_factor_without_bag"},
    "sweep": {"start_seconds", "cases_per_second", "cpu_ratio", "worker_bytes", "growth"},
}


def measured(folder: Path, suite: str, told: str = "4 robots") -> dict[str, Any]:
    """Return the document of a tiny run of a suite."""
    arguments = ["--suite", suite, "--repeat", "1", "--window", "0.6", "--json", "-o", str(folder)]
    busy = ["--starts", "2", "--busy"] if suite == "start" else []
    shown = subprocess.run([*BENCH, *arguments, *busy], capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(shown.stdout)
    assert found == json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))
    assert (folder / TABLES).is_file() and told in shown.stderr
    assert found["machine"]["cores"] >= 1 and found["settings"]["suites"] == [suite]
    return found


@pytest.mark.usefixtures("nothing_survives")
def test_functions_are_measured_with_those_of_the_machine(tmp_path: Path) -> None:
    rows = measured(tmp_path, "functions", "normal_quantile")["functions"]
    assert {row["function"] for row in rows} == {"sin", "cos", "exp", "expm1", "tanh", "log", "normal_quantile"}
    for row in rows:
        assert row["summary"].keys() == {"nanoseconds", "machine_nanoseconds", "ratio"}
        assert all(spread.keys() == SPREAD and spread["smallest"] > 0.0 for spread in row["summary"].values())
    compared = comparison({"functions": rows}, {"functions": rows}).rows
    assert [row[5] for row in compared] == ["1.00"] * len(compared) and len(compared) == 3 * len(rows)


@pytest.mark.usefixtures("nothing_survives")
def test_product_is_measured_with_all_baselines(tmp_path: Path) -> None:
    (row,) = measured(tmp_path, "product")["product"]
    (results,) = row["repeats"]
    assert results.keys() == row["summary"]["steps_per_second"].keys() == {*BASELINES, "product", "packed"}
    assert row["summary"]["ratio_to_floor"].keys() == SPREAD
    assert results["product"]["start_seconds"] > 0.0
    assert (tmp_path / CHART).is_file()


@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize("suite", MEASURES)
def test_a_suite_gives_a_well_formed_document(tmp_path: Path, suite: str) -> None:
    found = measured(tmp_path, suite)
    (row,) = found[suite]
    assert (row["robots"], row["summary"].keys()) == (4, MEASURES[suite])
    for spread in row["summary"].values():
        assert spread is None or (spread.keys() == SPREAD and spread["smallest"] > 0.0)
    if suite == "start":
        assert (row["starts"], row["clean"], row["failures"], len(row["repeats"])) == (2, 2, [], 2)
        assert row["busy_processes"] >= 2
    if suite == "large":
        assert (row["agents_per_process"], row["failures"]) == (3, [])
        assert (tmp_path / LARGE_CHART).is_file()
    if suite == "memory":
        assert row["repeats"][0]["coordinators"].keys() == {"plane", "observer", "controller", "recorder"}
    if suite == "simulate":
        assert found["solver"]["ratio"].keys() == SPREAD


@pytest.mark.parametrize("suite", ["product", "start", "large", "recorder"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_its_processes_end_with_it(nothing_survives: str, tmp_path: Path, suite: str, number: signal.Signals) -> None:
    """A benchmark that is killed cannot tidy up: the kernel ends what was started."""
    folder = tmp_path / "result"
    words = [*BENCH, "--suite", suite, "--repeat", "9", "--window", "30", "-o", str(folder)]
    own = {"TMPDIR": str(tmp_path)}  # its temporary files stay, as those of anything that is killed
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True, env={**os.environ, **own}) as process:
        assert process.stderr is not None and "4 robots" in process.stderr.readline()
        until(lambda: len(marked_processes(nothing_survives)) > 2, "its processes are there", 60.0)
        process.send_signal(number)
        _, errors = process.communicate()
        until(lambda: not marked_processes(nothing_survives), "all processes are gone")
    if number != signal.SIGKILL:
        assert (process.returncode, "interrupted" in errors) == (1, True)
        assert not folder.exists()


@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize("name", BASELINES)
def test_a_baseline_makes_steps_with_all_its_processes(name: str) -> None:
    found = measure_baseline(name, 4, warm_up=0.2, window=2.0)
    assert found.steps_per_second > 0.0
    assert found.start_seconds > 0.0
    assert found.load.cpu_share.keys() == {"plane", "observer", "controller", AGENTS}
    assert all(math.isfinite(share) and share >= 0.0 for share in found.load.cpu_share.values())


@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize(
    ("text", "warm_up", "reason"),
    [
        ("raise SystemExit('no such socket')", 1.0, "baseline broken: .*no such socket"),
        (BAD, 1.0, "baseline broken: .*bad exited with 1"),
        (LATE, 1.0, "baseline broken: .*late exited with 1"),
        (IDLE, 0.0, r"baseline broken with 4 robots: no step in 0\.1 s"),
        (MUTE, 0.0, r"baseline broken: no answer in 0\.2 s"),
    ],
)
def test_bad_baseline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, warm_up: float, reason: str) -> None:
    program = tmp_path / "program.py"
    program.write_text(text)
    monkeypatch.setitem(BASELINES, "broken", Baseline(str(program)))
    if text == MUTE:
        monkeypatch.setattr(baseline_programs, "START_SECONDS", 0.2)
        monkeypatch.setattr(baseline_programs, "END_SECONDS", 0.2)
    with pytest.raises(RunError, match=reason):
        measure_baseline("broken", 4, warm_up=warm_up, window=0.1)


def test_the_baselines_share_no_code_with_the_product() -> None:
    programs = list(FOLDER.glob("*.py"))
    assert {baseline.program for baseline in BASELINES.values()} <= {program.name for program in programs}
    for program in programs:
        nodes = list(ast.walk(ast.parse(program.read_text(encoding="utf-8"))))
        modules = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        modules += [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
        tops = {module.partition(".")[0] for module in modules}
        assert tops <= {*sys.stdlib_module_names, "workers", "rclpy", "zmq", "swarmabs_msgs"}, program
