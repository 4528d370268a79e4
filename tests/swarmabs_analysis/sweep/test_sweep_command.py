"""``swarm sweep`` as a process: the same results however many workers there are and however often it is stopped."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.processes import until
from tests.swarmabs_analysis.sweep.helpers import finished, rows, summary, workers

from swarmabs_cli import main

Sweep = Callable[..., tuple[int, str, str]]
Start = Callable[..., "subprocess.Popen[str]"]

FILES = {"region.png", "region.svg", "results.parquet", "scenario.yaml", "summary.json", "sweep.yaml"}
CASES = 36

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def slow(small: Path) -> Path:
    """The small sweep with cases that take long enough to be interrupted."""
    small.write_text(small.read_text().replace("0.2}", "4.0}"))
    return small


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES - {"summary.json"}}


def test_results_do_not_depend_on_the_number_of_jobs(sweep: Sweep, small: Path, tmp_path: Path) -> None:
    code, out, err = sweep(small, "-o", "one", "--jobs", 1)
    assert (code, out) == (0, "36 of 36 cases: 3 settled, 18 unsettled, 3 off_plane, 12 failed\nfolder: one\n")
    assert err.splitlines()[-1] == "small: 36 of 36 cases; 12 failed, 3 off_plane, 3 settled, 18 unsettled"
    code, out, _ = sweep(small, "-o", "three", "--jobs", 3, "--json")
    printed = json.loads(out)
    assert code == 0
    assert printed == summary(tmp_path / "three")
    assert {key: printed[key] for key in ("sweep", "cases", "finished", "engine", "computed", "status", "reason")} == {
        "sweep": "small",
        "cases": CASES,
        "finished": CASES,
        "engine": "3 processes here",
        "computed": CASES,
        "status": "ok",
        "reason": None,
    }
    assert printed["outcomes"] == {"settled": 3, "unsettled": 18, "off_plane": 3, "failed": 12, "refused": 0}
    assert names(tmp_path / "one") == names(tmp_path / "three") == FILES
    assert contents(tmp_path / "one") == contents(tmp_path / "three")
    assert [row["case"] for row in rows(tmp_path / "one")] == list(range(CASES))


def test_case_is_the_run_that_simulate_makes_of_it(
    sweep: Sweep, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep(small, "-o", "s")
    row = rows(tmp_path / "s")[9]
    swept = {name: value for name, value in row.items() if "." in name}
    settings = [f"--set={name}={value!r}" for name, value in {**swept, "seed": row["seed"]}.items()]
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "pd_het_4", "-o", "alone", "--duration", "0.2", "--no-bag", *settings]) == 0
    alone = summary(tmp_path / "alone")
    same = ("digest", "settled_at", "final_error", "rms_error", "max_abs_position", "messages")
    assert {name: alone[name] for name in same} == {name: row[name] for name in same}


def test_sweep_goes_on_after_a_kill(start: Start, sweep: Sweep, slow: Path, tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    killed = start(slow, "-o", folder, "--jobs", 2)
    until(lambda: finished(folder) > 5, "some cases are finished", 40.0)
    children = workers(killed.pid)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    until(lambda: not any(child.is_running() for child in children), "the workers end with who started them")
    done = finished(folder)
    assert 5 < done < CASES
    with (folder / "cases.jsonl").open("a") as file:
        file.write('{"case": 35, "sta')  # as if the last line had been torn
    assert names(folder) == {"cases.jsonl", "scenario.yaml", "sweep.yaml"}

    code, _, err = sweep(slow, "-o", folder)
    assert (code, err) == (
        2,
        f"error: {folder} holds a sweep already; go on with it with --resume, or name another folder\n",
    )
    assert finished(folder) == done

    assert sweep(slow, "-o", folder, "--resume")[0] == 0
    assert summary(folder)["computed"] == CASES - done
    assert names(folder) == FILES
    assert sweep(slow, "-o", tmp_path / "whole")[0] == 0
    assert contents(folder) == contents(tmp_path / "whole")

    kept = contents(folder)
    code, out, _ = sweep(folder / "sweep.yaml", "-o", folder, "--resume", "--json")  # complete: nothing is left to do
    assert (code, json.loads(out)) == (0, summary(folder))
    assert contents(folder) == kept


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_leaves_a_folder_to_go_on_with(
    start: Start, sweep: Sweep, slow: Path, tmp_path: Path, number: signal.Signals
) -> None:
    folder = tmp_path / "stopped"
    stopped = start(slow, "-o", folder, "--jobs", 2)
    until(lambda: finished(folder) > 2, "some cases are finished", 40.0)
    stopped.send_signal(number)
    out, err = stopped.communicate()
    assert stopped.returncode == 1
    assert out.endswith(f"folder: {folder}\n")
    assert err.endswith("error: interrupted; go on with --resume\n")
    assert "Traceback" not in err
    found = summary(folder)
    assert (found["status"], found["finished"]) == ("interrupted", finished(folder))
    slow.write_text(slow.read_text().replace("seed: 7", "seed: 8"))
    code, _, err = sweep(slow, "-o", folder, "--resume")
    assert code == 2
    assert "holds another sweep: sweep.yaml differs from line" in err
    assert found == summary(folder)


def test_worker_that_is_killed_costs_nothing(start: Start, sweep: Sweep, slow: Path, tmp_path: Path) -> None:
    hit = start(slow, "-o", "hit", "--jobs", 2)
    until(lambda: finished(tmp_path / "hit") > 2, "some cases are finished", 40.0)
    workers(hit.pid)[0].send_signal(signal.SIGKILL)
    hit.communicate()
    assert hit.returncode == 0
    assert sweep(slow, "-o", "whole")[0] == 0
    assert contents(tmp_path / "hit") == contents(tmp_path / "whole")


@pytest.mark.parametrize(
    ("change", "arguments", "expected"),
    [
        (("grid:", "gird:"), (), "small.yaml:4: gird: unknown key 'gird'; did you mean 'grid'?"),
        (("plane.angle", "plane.angel"), (), "unknown key 'angel'; did you mean 'angle'?"),
        (("", ""), ("--set", "plane.lenght=2"), "--set plane.lenght=2: plane.lenght: unknown key 'lenght'"),
        (("", ""), ("--resume",), "--resume needs the folder of the sweep: -o DIR"),
        (("", ""), ("--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"), "a scheduler has workers of its own"),
        (("", ""), ("--scheduler", "nonsense://1"), "no Dask scheduler at nonsense://1"),
        (("", ""), ("-o", "small.yaml"), "output folder small.yaml is not a folder"),
    ],
)
def test_refusal_is_one_line_and_leaves_nothing(
    small: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    change: tuple[str, str],
    arguments: tuple[str, ...],
    expected: str,
) -> None:
    small.write_text(small.read_text().replace(*change))
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", "small.yaml", *arguments]) == 2
    found = capsys.readouterr()
    assert expected in found.err
    assert (found.out, found.err.count("\n")) == ("", 1)
    assert names(tmp_path) == {"small.yaml"}


def test_new_sweep_may_be_started_with_resume(sweep: Sweep, small: Path, tmp_path: Path) -> None:
    assert sweep(small, "-o", "new", "--resume")[0] == 0
    assert names(tmp_path / "new") == FILES


def test_folder_without_a_sweep_is_refused(sweep: Sweep, small: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").touch()
    for more in ((), ("--resume",)):
        assert sweep(small, "-o", "full", *more)[0] == 2
    assert names(tmp_path / "full") == {"mine.txt"}
