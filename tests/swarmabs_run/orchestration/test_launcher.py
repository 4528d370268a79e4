"""The launcher and its children: none of them survives, however the others end."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
from tests.processes import SEARCH_PATH, marked_processes, until
from tests.swarmabs_run.orchestration.children import child

from swarmabs_config.graph import Driver
from swarmabs_run.ending import GRACE
from swarmabs_run.orchestration import machine
from swarmabs_run.orchestration.launcher import CROWD
from swarmabs_run.orchestration.machine import Machine

pytestmark = [pytest.mark.smoke, pytest.mark.timeout(300)]

ENVIRONMENT = {**SEARCH_PATH, "PYTHONUNBUFFERED": ""}
"""What is printed waits in the memory of a node until it is flushed."""
LARGEST_CALM = CROWD * len(os.sched_getaffinity(0))
"""So many nodes may interrupt each other."""


@pytest.fixture(autouse=True)
def at_once(nothing_survives: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give no time to end, as a measurement of coverage does: children here do not end by themselves."""
    monkeypatch.delenv(GRACE, raising=False)


class Launched:
    """A launcher, and what it and its children have reported."""

    def __init__(self, client: Machine, logs: Path) -> None:
        self.client = client
        self.logs = logs
        self._reports: list[dict[str, Any]] = []

    def reported(self, event: str, name: str) -> list[dict[str, Any]]:
        self._reports += self.client.listen(0.0)
        return [report for report in self._reports if (report["event"], report.get("name")) == (event, name)]

    def start(self, name: str, *arguments: str) -> int:
        self.client.spawn(child(name), [*arguments], self.logs / f"{name}.log")
        until(lambda: self.reported("spawned", name), f"{name} is started")
        return int(self.reported("spawned", name)[0]["child"])

    def waiting(self, name: str, *arguments: str) -> int:
        pid = self.start(name, *arguments)
        until(lambda: "waiting\n" in self.log(name), f"{name} waits")
        return pid

    def end_of(self, name: str) -> int:
        until(lambda: self.reported("exited", name), f"{name} has ended")
        return int(self.reported("exited", name)[0]["code"])

    def log(self, name: str) -> str:
        log = self.logs / f"{name}.log"
        return log.read_text(encoding="utf-8") if log.exists() else ""


@contextmanager
def launched(logs: Path, **options: Any) -> Iterator[Launched]:
    with (
        pytest.MonkeyPatch.context() as patch,
        Machine(ENVIRONMENT, logs / "launcher.log", **{"processes": 2, **options}) as client,
    ):
        patch.setattr(machine, "END_SECONDS", 1000.0)  # it ends by itself, not when the client loses patience
        yield Launched(client, logs)


def ended(pid: int) -> bool:
    """Tell whether a process has ended, even if whoever it was left to has not asked how."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def test_children_are_named_logged_and_heard_and_a_signal_reaches_the_one_it_is_meant_for(tmp_path: Path) -> None:
    with launched(tmp_path, processes=LARGEST_CALM) as launcher:
        plane = launcher.waiting("plane_sim", "wait")
        descriptors = {entry.name: str(entry.readlink()) for entry in Path(f"/proc/{plane}/fd").iterdir()}
        assert [descriptors.pop(number) for number in "012"] == [os.devnull, *[str(tmp_path / "plane_sim.log")] * 2]
        assert len(descriptors) == 2, "the pipes of reports and of the start"
        assert Path(f"/proc/{plane}/comm").read_text(encoding="utf-8").strip() == "plane_sim"
        assert os.getsid(plane) == launcher.client.launcher != os.getsid(0), "Ctrl-C in a terminal must not reach it"
        assert os.sched_getscheduler(plane) == os.SCHED_OTHER
        for name, arguments, code, logged in (
            ("none", ("exit", "0"), 0, "exit begins"),
            ("three", ("exit", "3"), 3, "exit begins"),
            ("eight", ("participant",), 8, "participant begins"),
            ("gain", ("raise", "no such gain"), 1, "RuntimeError: no such gain"),
            ("nodes", ("loaded", "agent_node.node", "plane_sim.node", "swarmabs_msgs.msg"), 0, "loaded begins"),
        ):
            launcher.start(name, *arguments)
            assert launcher.end_of(name) == code
            assert logged in launcher.log(name)
        other = launcher.waiting("other", "wait")
        launcher.client.signal("nobody", signal.SIGKILL)
        launcher.client.signal("other", signal.SIGKILL)
        assert launcher.end_of("other") == -signal.SIGKILL
        launcher.client.signal("other", signal.SIGKILL)  # it has ended: its number may be anybody's
        deaf = launcher.waiting("deaf", "ignore-sigterm")
        launcher.client.signal("deaf", signal.SIGTERM)
        launcher.client.signal("plane_sim", signal.SIGSTOP)
        until(lambda: psutil.Process(plane).status() == psutil.STATUS_STOPPED, "stopped")
        assert launcher.client.alive()
    assert not launcher.client.alive()
    assert [psutil.pid_exists(pid) for pid in (plane, other, deaf)] == [False] * 3
    assert launcher.log("launcher") == ""


@pytest.mark.system
def test_nodes_have_profiles_of_their_own_and_share_the_modules_of_the_run(tmp_path: Path) -> None:
    profile = tmp_path / "own.xml"
    with launched(tmp_path, modules=["agent_node.group"], profiles={"own": profile}) as launcher:
        for name, path in (("own", profile), ("other", "")):
            launcher.start(name, "profile", str(path))
            assert launcher.end_of(name) == 0
        launcher.start("nodes", "loaded", "agent_node.group")
        assert launcher.end_of("nodes") == 0


@pytest.mark.system
def test_nodes_in_real_time_start_at_one_signal_and_take_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """None of them holds the write end of the start pipe: then no other would ever see its end."""
    monkeypatch.setenv(GRACE, "1000")
    with launched(tmp_path, processes=LARGEST_CALM + 1, driver=Driver.REALTIME) as launcher:
        pids = [launcher.start(name, "start") for name in ("one", "two")]
        assert [os.sched_getscheduler(pid) for pid in pids] == [os.SCHED_BATCH] * 2
        launcher.start("nodes", "loaded", "agent_node.realtime", "plane_sim.realtime", "service_msgs.msg")
        assert launcher.end_of("nodes") == 0
        assert not any(launcher.reported("exited", name) for name in ("one", "two"))
        launcher.client.start_all(b"x" * 100)
        launcher.client.start_all()
        assert sorted(launcher.end_of(name) for name in ("one", "two")) == [0, 100]
        launcher.waiting("last", "end-in-order")
    assert "KeyboardInterrupt" in launcher.log("last")


def test_children_die_with_a_launcher_that_is_killed(tmp_path: Path) -> None:
    with launched(tmp_path) as launcher:
        pids = [launcher.waiting("one", "ignore-sigterm"), launcher.waiting("two", "wait")]
        os.kill(launcher.client.launcher, signal.SIGKILL)
        until(lambda: all(map(ended, pids)) and not launcher.client.alive(), "all are dead")
        launcher.client.spawn(child("three"), ["wait"], tmp_path / "three.log")  # nobody is there to hear it
    assert not launcher.log("three")


def test_launcher_and_children_die_with_an_orchestrator_that_is_killed(nothing_survives: str, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "tests.swarmabs_run.orchestration.children", tmp_path]
    logs = [tmp_path / "one.log", tmp_path / "two.log"]
    with subprocess.Popen(words, env={**os.environ, **SEARCH_PATH}) as orchestrator:
        until(lambda: all(log.exists() and "waiting" in log.read_text() for log in logs), "the children wait")
        assert len(marked_processes(nothing_survives)) == 4
        os.kill(orchestrator.pid, signal.SIGKILL)
        orchestrator.wait()
    until(lambda: not marked_processes(nothing_survives), "all are dead")


@pytest.mark.parametrize(
    ("modules", "heavy"),
    [
        ("swarmabs_run.orchestration.launcher", {"pydantic", "rich", "aiohttp", "matplotlib", "scipy"}),
        ("swarmabs_core.behaviours, swarmabs_core.controllers", {"numpy", "pydantic", "yaml", "scipy"}),
    ],
)
def test_neither_launcher_nor_robots_load_what_no_node_needs(modules: str, heavy: set[str]) -> None:
    """What the launcher loads is in the memory of every node, and what a robot imports a swarm imports often."""
    said = f"import sys, {modules}; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True).stdout.split()
    assert modules.partition(",")[0] in loaded
    assert not heavy & set(loaded)
