"""The processes of a run that is going on: found by its folder, named by their logs, gone when the run is over."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.processes import until

from swarmabs_cli import main
from swarmabs_core.errors import InputError
from swarmabs_fleet.operate import target
from swarmabs_run.orchestration.run_files import (
    PROGRESS_INTERVAL,
    ProgressFile,
    RunOverError,
    Told,
    environment_of_run,
    read_progress,
    start_of,
)
from swarmabs_run.processes import RunProcesses, newest_run

SWARM = [sys.executable, "-m", "swarmabs_cli"]
NODES = {"plane_sim", "abstraction_observer", "parent_controller", "recorder"}
NODES |= {f"agent_00{agent}" for agent in (1, 2, 3, 4)}


def folder_of(tmp_path: Path, pid: int, name: str = "run") -> Path:
    logs = tmp_path / name / "logs"
    logs.mkdir(parents=True)
    network = {"domain": 5, "participants": 12, "realtime": False, "orchestrator": pid, "started": start_of(pid)}
    (logs / "network.json").write_text(json.dumps(network), encoding="utf-8")
    return logs.parent


def test_progress_is_written_now_and_then(tmp_path: Path) -> None:
    file = ProgressFile(tmp_path)
    file.tell("starting", 0, 100, 10.0)
    assert read_progress(tmp_path) == Told("starting", 0, 100, None, 10.0)
    file.tell("running", 0, 100, 10.1)  # the phase is another one
    file.tell("running", 30, 100, 10.2)
    assert read_progress(tmp_path) == Told("running", 0, 100, None, 10.1)
    file.tell("running", 50, 100, 10.1 + PROGRESS_INTERVAL)
    told = read_progress(tmp_path)
    assert told is not None and told.step_rate == pytest.approx(50 / PROGRESS_INTERVAL)
    file.over()
    told = read_progress(tmp_path)
    assert told is not None and told[:4] == ("over", 50, 100, None)
    assert [path.name for path in tmp_path.iterdir()] == ["progress.json"]


def test_a_full_disk_does_not_end_the_run(tmp_path: Path) -> None:
    ProgressFile(tmp_path / "nowhere").tell("running", 1, 2, 3.0)


@pytest.mark.parametrize("content", ["", "[]", "{}", "null", '{"orchestrator": null}', '{"orchestrator": "x"}'])
def test_a_damaged_folder_is_refused(tmp_path: Path, content: str) -> None:
    folder = folder_of(tmp_path, 1)
    (folder / "logs" / "network.json").write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=r"network\.json: not what a run writes there"):
        RunProcesses(folder)


def test_folders_without_a_run_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not the folder of a run with processes"):
        RunProcesses(tmp_path)
    with pytest.raises(InputError, match=r"no run in .* is going on"):
        newest_run(tmp_path)


def test_a_process_that_has_got_the_id_later_is_not_the_run(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, os.getpid())
    assert RunProcesses(folder).going_on()
    network = folder / "logs" / "network.json"
    written = json.loads(network.read_text())
    network.write_text(json.dumps(written | {"started": written["started"] - 1}))
    with pytest.raises(RunOverError, match="this run is over"):
        RunProcesses(folder)
    with pytest.raises(RunOverError, match="this run is over"):
        environment_of_run(folder)
    with pytest.raises(InputError, match="no run in"):
        newest_run(tmp_path)


def test_a_run_that_says_that_it_is_over_is_over(tmp_path: Path) -> None:
    """The process that has started it may live on, such as a notebook."""
    folder = folder_of(tmp_path, os.getpid())
    processes = RunProcesses(folder)
    assert environment_of_run(folder)["ROS_DOMAIN_ID"] == "5"
    ProgressFile(folder / "logs").over()
    assert not processes.going_on()
    with pytest.raises(RunOverError):
        environment_of_run(folder)
    with pytest.raises(RunOverError), target(folder):
        pass


def test_a_run_in_lockstep_has_no_operator(tmp_path: Path) -> None:
    with (
        pytest.raises(InputError, match="a run in lockstep has no operator; look at it with top"),
        target(folder_of(tmp_path, os.getpid())),
    ):
        pass


def test_the_start_of_a_process_is_the_kernels() -> None:
    ticks, hertz = start_of(os.getpid()), os.sysconf("SC_CLK_TCK")
    assert ticks is not None
    assert psutil.Process().create_time() == pytest.approx(psutil.boot_time() + ticks / hertz, abs=1.0)
    assert start_of(2**22 + 1) is None


def test_the_speed_of_a_run_that_stands_still_is_not_known(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, os.getpid())
    file = ProgressFile(folder / "logs")
    file.tell("running", 0, 100, 10.0)
    file.tell("running", 60, 100, 11.0)
    processes = RunProcesses(folder)
    assert processes.snapshot(11.5).step_rate == pytest.approx(60.0)
    assert processes.snapshot(20.0).step_rate is None


def top(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    words = [*SWARM, "top", *map(str, arguments)]
    return subprocess.run(words, check=False, capture_output=True, text=True, timeout=60, **options)


@pytest.mark.system
@pytest.mark.timeout(180)
def test_top_of_a_run(tmp_path: Path, nothing_survives: str) -> None:
    words = [*SWARM, "run", "--duration", "10000", "--no-bag"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as run:
        folder = tmp_path / "runs" / "pd_het_4-001"
        try:
            until(lambda: (told := read_progress(folder / "logs")) is not None and told.step > 100, "steps", 60.0)
            found = json.loads(top("--json", cwd=tmp_path).stdout)
            rows = {row["name"]: row for row in found["processes"]}
            assert rows.keys() == NODES | {"orchestrator", "launcher"}
            assert (found["run"], found["phase"], found["steps"]) == ("runs/pd_het_4-001", "running", 1_000_000)
            assert found["step"] > 100 and found["step_rate"] > 0.0
            assert rows["orchestrator"]["pid"] == run.pid
            children = {child.pid: child for child in psutil.Process(run.pid).children(recursive=True)}
            assert {row["pid"] for row in rows.values()} == {run.pid, *children}
            # The kernel knows a node by the first 15 characters of its name.
            assert all(children[rows[node]["pid"]].name()[:15] == node[:15] for node in NODES)
            assert all(0 < row["pss"] <= 2 * row["rss"] for row in rows.values())
            assert sum(row["cpu"] for row in rows.values()) > 0.0
            shown = top(folder, "--once").stdout
            assert all(f"\n{node} " in shown for node in NODES) and "steps/s" in shown
            # Without an end it ends with the run, as a pager's input or on a terminal.
            words = [*SWARM, "top", str(folder), "--interval", "0.2"]
            with subprocess.Popen(words, stdout=subprocess.PIPE) as watching:
                assert watching.stdout is not None and b"running" in watching.stdout.readline()
                run.send_signal(signal.SIGINT)
                watching.communicate(timeout=60)
            assert watching.returncode == 0
        finally:
            run.send_signal(signal.SIGINT)
            run.communicate(timeout=60)
    over = top(folder, "--once")
    text = f"error: {folder}: this run is over\n"
    assert (over.returncode, over.stderr) == (2, text)


def test_refusals_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["top"]) == 2
    assert main(["top", "nowhere"]) == 2
    errors = capfd.readouterr().err.splitlines()
    assert errors[0].startswith("error: no run in runs/ is going on")
    assert errors[1].startswith("error: nowhere is not the folder of a run with processes")
