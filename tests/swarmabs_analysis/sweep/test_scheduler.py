"""A real Dask scheduler with worker processes on loopback."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from tests.processes import until
from tests.swarmabs_analysis.sweep.helpers import finished, summary

import swarmabs_core

pytestmark = [pytest.mark.full, pytest.mark.timeout(90), pytest.mark.usefixtures("nothing_survives")]

Start = Callable[..., "subprocess.Popen[str]"]
Sweep = Callable[..., tuple[int, str, str]]


class Cluster:
    """A scheduler and a nanny with two workers."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.address = ""
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-jupyter")
        until(self._listens, "the scheduler listens", 40.0)
        self.nanny: subprocess.Popen[bytes] | None = None

    def add_workers(self, **environment: str) -> None:
        arguments = (self.address, "--nworkers", "2", "--nthreads", "1")
        self.nanny = self._start("dask_worker", *arguments, **environment)

    def workers(self) -> list[psutil.Process]:
        assert self.nanny is not None
        children = psutil.Process(self.nanny.pid).children()
        return [child for child in children if any("spawn_main" in part for part in child.cmdline())]

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


def test_worker_that_is_killed_costs_nothing(
    cluster: Cluster, start: Start, sweep: Sweep, small: Path, tmp_path: Path
) -> None:
    small.write_text(small.read_text().replace("0.2}", "3.0}"))
    cluster.add_workers()
    remote = start(small, "-o", "remote", "--scheduler", cluster.address)
    until(lambda: finished(tmp_path / "remote") > 2, "some cases are finished", 60.0)
    cluster.workers()[0].send_signal(signal.SIGKILL)
    _, err = remote.communicate()
    assert (remote.returncode, "Traceback" in err) == (0, False)
    assert summary(tmp_path / "remote")["engine"] == f"Dask workers at {cluster.address}"
    assert sweep(small, "-o", "local")[0] == 0
    for name in ("results.parquet", "region.png", "sweep.yaml"):
        assert (tmp_path / "remote" / name).read_bytes() == (tmp_path / "local" / name).read_bytes()


def test_workers_with_another_swarmabs_are_refused(cluster: Cluster, sweep: Sweep, small: Path, tmp_path: Path) -> None:
    """A single changed line of the mathematics is another swarmabs, whatever its version says."""
    other = tmp_path / "other"
    shutil.copytree(Path(swarmabs_core.__file__).parent, other / "swarmabs_core")
    with (other / "swarmabs_core" / "plant.py").open("a", encoding="utf-8") as file:
        file.write("\n# changed\n")
    cluster.add_workers(PYTHONPATH=os.pathsep.join([str(other), os.environ["PYTHONPATH"]]))
    code, _, err = sweep(small, "-o", "remote", "--scheduler", cluster.address)
    assert (code, "Traceback" in err) == (2, False)
    assert "error: worker tcp://127.0.0.1:" in err
    assert "install the same there and start it again" in err
    assert not (tmp_path / "remote").exists()


def test_scheduler_that_is_lost_leaves_a_folder_to_go_on_with(
    cluster: Cluster, start: Start, sweep: Sweep, small: Path, tmp_path: Path
) -> None:
    small.write_text(small.read_text().replace("0.2}", "3.0}"))
    cluster.add_workers()
    remote = start(small, "-o", "remote", "--scheduler", cluster.address)
    until(lambda: finished(tmp_path / "remote") > 2, "some cases are finished", 60.0)
    cluster.scheduler.kill()
    _, err = remote.communicate()
    assert remote.returncode == 1
    assert "; go on with --resume" in err.splitlines()[-1]
    assert "Traceback" not in err
    assert sweep(small, "-o", "remote", "--resume")[0] == 0
    assert summary(tmp_path / "remote")["computed"] < 36
