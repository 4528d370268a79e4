"""``swarm sweep``: the same results however often it is stopped, in a folder that is mended after a crash."""

import json
import os
import signal
from collections.abc import Callable, Iterator
from csv import DictReader
from pathlib import Path
from typing import ClassVar

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat
from tests.frozen.command import Finished, swarm
from tests.processes import until
from tests.swarmabs_analysis.sweep.conftest import Start, finished, summary, workers

from swarmabs_analysis.sweep.evaluate import Task, evaluate
from swarmabs_analysis.sweep.executor import Executor
from swarmabs_analysis.sweep.folder import SweepFolder, find_folder, make_folder
from swarmabs_analysis.sweep.study import Study, load_sweep
from swarmabs_core.errors import InputError, RunError

FIRST, SECOND = '{"case": 4, "outcome": "settled"}', '{"case": 1, "outcome": "failed"}'


@pytest.mark.parametrize(
    "torn",
    [
        *(b"", b'{"case": 2', b'{"case": 2}', b"\0\0\0\n", b"[]\n", b'{"x": 1}\n{"case": 9}\n'),
        b'{"case": 2, "outcome": "failed"}',  # all but the end of the line
    ],
)
def test_what_a_crash_has_torn_is_cut_off(tmp_path: Path, torn: bytes) -> None:
    with SweepFolder(tmp_path) as folder:
        folder.add(FIRST)
    with folder.journal.open("ab") as file:
        file.write(torn)
    with SweepFolder(tmp_path) as folder:
        assert list(folder.rows) == [4]
        folder.add(SECOND)
    assert folder.journal.read_text() == f"{FIRST}\n{SECOND}\n"
    with SweepFolder(tmp_path) as folder:
        assert folder.rows == {4: json.loads(FIRST), 1: json.loads(SECOND)}
        assert folder.outcomes == {"settled": 1, "failed": 1}


def test_another_writer_is_refused_and_a_full_disk_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with SweepFolder(tmp_path) as folder:
        folder.add(FIRST)
        with pytest.raises(InputError, match="is in use by another sweep"), SweepFolder(tmp_path):
            pass

        def full(descriptor: int, content: bytes) -> None:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr(os, "write", full)
            with pytest.raises(RunError, match=r"cases\.jsonl: No space left on device; free space"):
                folder.add(SECOND)
            patch.setattr(os, "fsync", lambda descriptor: full(descriptor, b""))
            with pytest.raises(RunError, match=r"summary\.json: "):
                folder.write_whole(folder.summary, b"{}")
    assert [path.name for path in tmp_path.iterdir()] == ["cases.jsonl"]
    with SweepFolder(tmp_path) as folder:
        assert list(folder.rows) == [4]


def test_a_row_of_which_the_system_writes_a_part_at_a_time_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.write
    with SweepFolder(tmp_path) as folder, monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda descriptor, content: write(descriptor, content[:7]))
        folder.add(FIRST)
        folder.add(SECOND)
    assert folder.journal.read_text() == f"{FIRST}\n{SECOND}\n"


def test_new_folder_holds_the_sweep_and_no_other(study: Study, small: Path, tmp_path: Path) -> None:
    folder = make_folder(study, tmp_path / "new", tmp_path)
    assert (folder.path / "sweep.yaml").read_text() == study.sweep_text
    assert (folder.path / "scenario.yaml").read_text() == study.scenario
    assert find_folder(study, folder.path).path == folder.path
    with pytest.raises(InputError, match="already contains a sweep; continue it with --resume"):
        make_folder(study, folder.path, tmp_path)
    made = [make_folder(study, None, tmp_path / "runs").path.name for _ in range(2)]
    assert made == ["small-001", "small-002"]
    # Another sweep is not gone on with.
    small.write_text(small.read_text().replace("seed: 7", "seed: 8"))
    with pytest.raises(InputError, match=r"contains another sweep: sweep\.yaml differs from line 11 on"):
        find_folder(load_sweep(small), folder.path)
    with pytest.raises(InputError, match=r"contains another sweep: scenario\.yaml differs from line"):
        find_folder(load_sweep(small, ["plane.inertia=1"]), folder.path)
    (folder.path / "sweep.yaml").unlink()
    with pytest.raises(InputError, match=r"sweep\.yaml cannot be read: No such file"):
        find_folder(study, folder.path)


def test_only_summary_and_results_together_are_complete(tmp_path: Path) -> None:
    folder = SweepFolder(tmp_path)
    for content in ('{"status": "ok"}', "", "{", '{"status": "interrupted"}'):
        folder.summary.write_text(content)
        assert folder.complete() is None
        folder.results.touch()
    folder.summary.write_text('{"status": "ok", "cases": 3}')
    assert folder.complete() == {"status": "ok", "cases": 3}


FILES = {
    *("columns.csv", "region.png", "region.svg", "results.csv", "results.mat", "results.parquet"),
    *("scenario.yaml", "summary.json", "sweep.yaml"),
}
CASES = 36


class Here(Executor):
    """Computes cases in this process, as many as it is told; then it is interrupted, or fails."""

    limit = CASES
    end: type[BaseException] = KeyboardInterrupt
    given: ClassVar[list[int]] = []

    def __init__(self, jobs: int | None = None) -> None:
        super().__init__(f"{jobs} local processes")

    def compute(self, tasks: Iterator[Task], idle: Callable[[], None]) -> Iterator[str]:
        for number, task in enumerate(tasks):
            if number == self.limit:
                raise self.end("no worker is left")
            idle()
            self.given.append(task.case)
            yield evaluate(task)


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> type[Here]:
    """Have sweeps computed in this process."""
    monkeypatch.setattr("swarmabs_analysis.sweep.executor.LocalExecutor", Here)
    monkeypatch.setattr(Here, "limit", CASES)
    return Here


def sweep(*words: object, cwd: Path) -> Finished:
    return swarm(("sweep", *words), cwd)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def contents(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in FILES - {"summary.json"}}


def test_a_sweep_has_a_row_for_each_case_as_simulate_runs_it(here: type[Here], small: Path, tmp_path: Path) -> None:
    done = sweep(small, "-o", "s", "--jobs", 3, cwd=tmp_path)
    assert (done.code, done.out) == (0, "36 of 36 cases: 3 settled, 18 unsettled, 3 off_plane, 12 failed\nfolder: s\n")
    assert done.err.splitlines()[-1] == "small: 36 of 36 cases; 12 failed, 3 off_plane, 3 settled, 18 unsettled"
    found = summary(tmp_path / "s")
    assert found["cases_per_second"] > 0 < found["wall_time"]
    assert found["cases"] == found["finished"] == found["computed"] == CASES
    told = [found[key] for key in ("sweep", "engine", "status", "reason")]
    assert told == ["small", "3 local processes", "ok", None]
    assert found["outcomes"] == {"settled": 3, "unsettled": 18, "off_plane": 3, "failed": 12, "refused": 0}
    assert names(tmp_path / "s") == FILES
    table = pq.read_table(tmp_path / "s" / "results.parquet").to_pylist()
    assert [row["case"] for row in table] == list(range(CASES))
    with (tmp_path / "s" / "results.csv").open(encoding="utf-8", newline="") as file:
        lines = list(DictReader(file))
    texts = [{name: "" if value is None else value for name, value in row.items()} for row in table]
    assert [list(line) for line in lines] == [list(row) for row in table]
    for line, expected in zip(lines, texts, strict=True):
        for name, cell in line.items():
            assert (cell if isinstance(expected[name], str) else json.loads(cell)) == expected[name]
    with (tmp_path / "s" / "columns.csv").open(encoding="utf-8", newline="") as file:
        described = {line["column"]: (line["type"], line["unit"]) for line in DictReader(file)}
    assert list(described) == list(table[0])
    units = {"settled_at": "s", **dict.fromkeys(("final_error", "rms_error", "max_abs_angle", "plane.angle"), "rad")}
    units |= {"max_abs_position": "m", "plane.angular_velocity": "rad/s", "swarm.agents.0.mass": "kg"}
    assert {name: unit for name, (_, unit) in described.items() if unit} == units
    schema = pq.read_schema(tmp_path / "s" / "results.parquet")
    assert {field.name: field.metadata.get(b"unit", b"").decode() for field in schema} == {
        name: unit for name, (_, unit) in described.items()
    }
    mat = loadmat(tmp_path / "s" / "results.mat", simplify_cells=True)
    columns = {name.replace(".", "_"): [row[name] for row in table] for name in table[0]}
    assert set(mat["results"]) == set(mat["units"]) == set(columns)
    for name, values in columns.items():
        found = [None if np.size(cell) == 0 or cell != cell else cell for cell in mat["results"][name]]  # noqa: PLR0124
        assert found == values
    assert (mat["units"]["plane_angle"], mat["units"]["rms_error"]) == ("rad", "rad")
    whole = loadmat(tmp_path / "s" / "results.mat")["results"]
    assert {whole[name][0, 0].shape for name in columns} == {(CASES, 1)}  # as struct2table needs them
    row = table[9]
    swept = {name: value for name, value in row.items() if "." in name}
    settings = [f"--set={name}={value!r}" for name, value in {**swept, "seed": row["seed"]}.items()]
    words = ("simulate", "pd_het_4", "-o", "alone", "--duration", "0.2", "--no-bag", "--json", *settings)
    alone = swarm(words, tmp_path).document()
    same = ("digest", "settled_at", "final_error", "rms_error", "max_abs_position", "messages")
    assert {name: alone[name] for name in same} == {name: row[name] for name in same}


@pytest.mark.parametrize(
    ("end", "status", "reason"),
    [
        (KeyboardInterrupt, "interrupted", "interrupted; continue with --resume"),
        pytest.param(RunError, "failed", "no worker is left", marks=pytest.mark.system),
    ],
)
def test_a_sweep_that_was_stopped_goes_on_and_ends_as_if_it_had_not_been(
    here: type[Here], monkeypatch: pytest.MonkeyPatch, small: Path, tmp_path: Path, end: type, status: str, reason: str
) -> None:
    folder = tmp_path / "stopped"
    with monkeypatch.context() as patch:
        patch.setattr(here, "limit", 5)
        patch.setattr(here, "end", end)
        stopped = sweep(small, "-o", folder, "--resume", cwd=tmp_path)  # also the first time
    assert (stopped.code, stopped.out.splitlines()[-1]) == (1, f"folder: {folder}")
    assert stopped.err.endswith(f"error: {reason}\n")
    found = summary(folder)
    assert (found["status"], found["reason"], found["finished"], found["computed"]) == (status, reason, 5, 5)
    assert finished(folder) == 5

    again = sweep(small, "-o", folder, cwd=tmp_path)
    assert (again.code, again.err.count("\n")) == (2, 1)
    assert "already contains a sweep; continue it with --resume, or name another folder" in again.err
    text = small.read_text()
    small.write_text(text.replace("seed: 7", "seed: 8"))
    other = sweep(small, "-o", folder, "--resume", cwd=tmp_path)
    assert (other.code, "contains another sweep: sweep.yaml differs from line" in other.err) == (2, True)
    assert (summary(folder), finished(folder)) == (found, 5)

    small.write_text(text)
    here.given.clear()
    assert sweep(small, "-o", folder, "--resume", cwd=tmp_path).code == 0
    assert summary(folder)["computed"] == CASES - 5
    assert here.given == [*range(5, CASES)]
    assert names(folder) == FILES
    assert sweep(small, "-o", "whole", cwd=tmp_path).code == 0
    kept = contents(folder)
    assert kept == contents(tmp_path / "whole")
    monkeypatch.setattr(here, "limit", 0)  # complete: nothing is left to do
    complete = sweep(folder / "sweep.yaml", "-o", folder, "--resume", "--json", cwd=tmp_path)
    assert (complete.code, complete.document()) == (0, summary(folder))
    assert contents(folder) == kept


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("bad.yaml",), "bad.yaml:4: gird: unknown key 'gird'; did you mean 'grid'?"),
        (("small.yaml", "--set", "plane.lenght=2"), "--set plane.lenght=2: plane.lenght: unknown key 'lenght'"),
        (("small.yaml", "--resume"), "--resume needs the folder of the sweep; name it with -o DIR"),
        (("small.yaml", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"), "which has its own workers"),
        (("small.yaml", "--scheduler", "nonsense://1"), "no Dask scheduler at nonsense://1"),
        (("small.yaml", "-o", "small.yaml"), "output folder small.yaml is not a folder"),
        (("small.yaml", "-o", "full"), "full"),
        (("small.yaml", "-o", "full", "--resume"), "full"),
    ],
)
def test_refusal_is_one_line_without_files(small: Path, tmp_path: Path, words: tuple[str, ...], expected: str) -> None:
    (tmp_path / "bad.yaml").write_text(small.read_text().replace("grid:", "gird:"))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").touch()
    done = sweep(*words, cwd=tmp_path)
    assert (done.code, done.out, done.err.count("\n")) == (2, "", 1)
    assert expected in done.err
    assert (names(tmp_path), names(tmp_path / "full")) == ({"small.yaml", "bad.yaml", "full"}, {"mine.txt"})


@pytest.mark.system
@pytest.mark.timeout(240)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_an_ended_process_leaves_no_worker(start: Start, small: Path, tmp_path: Path, number: signal.Signals) -> None:
    folder = tmp_path / "ended"
    small.write_text(small.read_text().replace("0.2}", "4.0}"))  # cases that take long enough to be interrupted
    process = start(small, "-o", folder, "--jobs", 2)
    until(lambda: finished(folder) > 2, "some cases are finished", 150.0)
    children = workers(process.pid)
    process.send_signal(number)
    _, err = process.communicate()
    until(lambda: not any(child.is_running() for child in children), "the workers end with who started them")
    done = finished(folder)
    assert 2 < done < CASES
    if number is signal.SIGKILL:
        assert names(folder) == {"cases.jsonl", "scenario.yaml", "sweep.yaml"}
    else:
        assert (process.returncode, "Traceback" in err) == (1, False)
        assert err.endswith("error: interrupted; continue with --resume\n")
        assert (summary(folder)["status"], summary(folder)["finished"]) == ("interrupted", done)
    resumed = start(small, "-o", folder, "--resume", "--json")
    out, _ = resumed.communicate()
    assert (resumed.returncode, json.loads(out)["computed"]) == (0, CASES - done)
    assert names(folder) == FILES
