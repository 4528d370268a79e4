"""Worker processes here and of a Dask scheduler on loopback: they may die, and must have the same swarmabs."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from tests.processes import until
from tests.swarmabs_analysis.sweep.conftest import Start, finished, summary, workers

import swarmabs_core
from swarmabs_analysis.sweep.evaluate import Task, evaluate
from swarmabs_analysis.sweep.executor import ATTEMPTS, SOURCES, Identity, LocalExecutor, different_worker, identity
from swarmabs_analysis.sweep.study import Study
from swarmabs_core.errors import RunError

BUSY = 5.0
"""Processor time, s, after which a worker has done more than to start."""

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def executor(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalExecutor]:
    for name in ("MALLOC_TRIM_THRESHOLD_", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, os.environ.get(name, "1"))  # Dask sets them for its workers
    executor = LocalExecutor(2)
    yield executor
    executor.close()
    assert not workers(os.getpid())


@pytest.mark.system
def test_rows_are_those_of_the_cases_whoever_computes_them(executor: LocalExecutor, study: Study) -> None:
    tasks = [study.task(index) for index in range(study.sweep.count)]
    rows = executor.compute(iter(tasks), lambda: None)
    found = [next(rows)]
    loopback = {connection.laddr.ip for connection in psutil.net_connections("tcp") if connection.pid == os.getpid()}
    assert loopback == {"127.0.0.1"}
    found = sorted([*found, *rows], key=lambda line: json.loads(line)["case"])
    assert found == [evaluate(task) for task in tasks]
    assert LocalExecutor().description == f"{len(os.sched_getaffinity(0))} local processes"


@pytest.mark.system
def test_case_of_a_killed_worker_is_computed_again(executor: LocalExecutor, study: Study) -> None:
    rows = executor.compute((study.task(index) for index in range(study.sweep.count)), lambda: None)
    found = [next(rows)]
    killed = workers(os.getpid())
    for worker in killed:
        worker.send_signal(signal.SIGKILL)
    found += rows
    assert len(killed) == 2
    assert sorted(json.loads(line)["case"] for line in found) == list(range(36))
    assert "died" not in "".join(found)


@pytest.mark.system
def test_case_that_kills_its_workers_is_given_up_and_no_other(executor: LocalExecutor, study: Study) -> None:
    killed = set()

    def kill() -> None:  # called while nothing is ready: what is computed is the endless case
        for worker in workers(os.getpid()):
            if worker.cpu_times().user > BUSY:
                killed.add(worker.pid)
                worker.kill()

    durations = enumerate((1000000, 0.1, 0.1, 0.1))
    tasks = [Task(study.scenario, number, (f"duration={time}",), 0.2) for number, time in durations]
    found = [json.loads(line) for line in executor.compute(iter(tasks), kill)]
    assert len(killed) == ATTEMPTS
    assert [row["case"] for row in found if row["status"] == "failed"] == [0]
    assert found[-1]["reason"] == "3 worker processes died while computing it"
    assert {row["case"] for row in found} == {0, 1, 2, 3}


@pytest.mark.system
def test_failed_worker_ends_the_sweep(executor: LocalExecutor, study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    with pytest.raises(RunError, match=r"worker processes did not start: .*; try fewer with --jobs"):
        list(executor.compute(iter([study.task(0)]), lambda: None))


MINE = Identity("0.1.0", "aaaa")


def test_the_same_sources_elsewhere_are_the_same_and_any_change_is_another(tmp_path: Path) -> None:
    ignore = shutil.ignore_patterns("__pycache__")
    sources = {n: Path(shutil.copytree(folder, tmp_path / n, ignore=ignore)) for n, folder in SOURCES.items()}
    mine = identity()
    assert identity(sources) == mine
    for package, name in (("swarmabs_core", "plant.py"), ("swarmabs_core", "controllers.py"), ("sweep", "evaluate.py")):
        path = sources[package] / name
        content = path.read_bytes()
        path.write_bytes(content + b"\n")
        changed = identity(sources)
        assert changed.version == mine.version
        assert changed.sources != mine.sources
        path.write_bytes(content)
    path.rename(path.with_name("evaluated.py"))
    assert identity(sources).sources != mine.sources


def test_another_version_or_other_sources_are_named_with_the_worker() -> None:
    for theirs in (MINE._replace(version="0.0.9"), MINE._replace(sources="bbbb")):
        assert different_worker(MINE, {"tcp://a:1": MINE, "tcp://b:2": theirs}) == (
            f"worker tcp://b:2 has swarmabs {theirs.version}, sources {theirs.sources}, but this process has 0.1.0,"
            " sources aaaa"
        )


class Cluster:
    """A Dask scheduler and a nanny with two workers."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.address = ""
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-jupyter")
        until(self._listens, "the scheduler listens", 40.0)
        self.nanny: subprocess.Popen[bytes] | None = None

    def add_workers(self, **environment: str) -> subprocess.Popen[bytes]:
        arguments = (self.address, "--nworkers", "2", "--nthreads", "1")
        self.nanny = self._start("dask_worker", *arguments, **environment)
        return self.nanny

    def close(self) -> None:
        for process in (self.nanny, self.scheduler):
            if process is not None:
                process.terminate()
                try:
                    process.wait(timeout=10)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()

    def _start(self, module: str, *arguments: str, **variables: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments, "--no-dashboard"]
        environment = {**os.environ, "DASK_TEMPORARY_DIRECTORY": str(self._folder), **variables}
        with (self._folder / f"{module}.log").open("wb") as log:
            return subprocess.Popen(command, env=environment, stdout=log, stderr=log, start_new_session=True)

    def _listens(self) -> bool:
        log = (self._folder / "dask_scheduler.log").read_text()
        found = [word for word in log.split() if word.startswith("tcp://127.0.0.1:")]
        self.address = found[0].rstrip(",") if found else ""
        return bool(found)


@pytest.fixture
def cluster(nothing_survives: str, tmp_path: Path) -> Iterator[Cluster]:
    folder = tmp_path / "dask"
    folder.mkdir()
    cluster = Cluster(folder)
    yield cluster
    cluster.close()


@pytest.mark.full
def test_workers_with_another_swarmabs_are_refused(cluster: Cluster, start: Start, small: Path, tmp_path: Path) -> None:
    """A single changed line of the mathematics is another swarmabs, whatever its version says."""
    other = tmp_path / "other"
    shutil.copytree(Path(swarmabs_core.__file__).parent, other / "swarmabs_core")
    with (other / "swarmabs_core" / "plant.py").open("a", encoding="utf-8") as file:
        file.write("\n# changed\n")
    cluster.add_workers(PYTHONPATH=os.pathsep.join([str(other), os.environ["PYTHONPATH"]]))
    remote = start(small, "-o", "remote", "--scheduler", cluster.address)
    _, err = remote.communicate()
    assert (remote.returncode, "Traceback" in err) == (2, False)
    assert "error: worker tcp://127.0.0.1:" in err
    assert "install the same there and start it again" in err
    assert not (tmp_path / "remote").exists()


@pytest.mark.full
@pytest.mark.parametrize("lost", ["worker", "scheduler"])
def test_a_worker_that_is_killed_costs_nothing_and_a_lost_scheduler_leaves_a_folder_to_go_on_with(
    cluster: Cluster, start: Start, small: Path, tmp_path: Path, lost: str
) -> None:
    small.write_text(small.read_text().replace("0.2}", "3.0}"))
    nanny = cluster.add_workers()
    remote = start(small, "-o", "remote", "--scheduler", cluster.address)
    until(lambda: finished(tmp_path / "remote") > 2, "some cases are finished", 60.0)
    (workers(nanny.pid)[0] if lost == "worker" else cluster.scheduler).kill()
    _, err = remote.communicate()
    assert (remote.returncode, "Traceback" in err) == (int(lost == "scheduler"), False)
    local = start(small, "-o", "local") if lost == "worker" else start(small, "-o", "remote", "--resume")
    local.communicate()
    assert local.returncode == 0
    if lost == "scheduler":
        assert "; continue with --resume" in err.splitlines()[-1]
        assert summary(tmp_path / "remote")["computed"] < 36
        return
    assert summary(tmp_path / "remote")["engine"] == f"Dask workers at {cluster.address}"
    for name in ("results.parquet", "region.png", "sweep.yaml"):
        assert (tmp_path / "remote" / name).read_bytes() == (tmp_path / "local" / name).read_bytes()
