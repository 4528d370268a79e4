"""The launcher and its children: none of them survives, however the others end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from tests.processes import SEARCH_PATH, marked_processes, until
from tests.swarmabs_run.orchestration.launching import Reader, child, is_waiting

from swarmabs_run.orchestration.launcher_client import LauncherClient

pytestmark = [pytest.mark.usefixtures("nothing_survives"), pytest.mark.timeout(60)]


@pytest.fixture
def client(nothing_survives: str, tmp_path: Path) -> Iterator[LauncherClient]:
    with LauncherClient(SEARCH_PATH, tmp_path / "launcher.log", processes=2) as client:
        yield client


def start(client: LauncherClient, logs: Path, **children: list[str]) -> dict[str, int]:
    """Start children; return their process ids once those that wait are waiting."""
    reader = Reader(client)
    pids = {}
    for name, arguments in children.items():
        client.spawn(child(name), arguments, logs / f"{name}.log")
        pid = reader.wait_for("spawned", name)["child"]
        assert isinstance(pid, int)
        pids[name] = pid
        until(lambda name=name: is_waiting(logs / f"{name}.log"), f"{name} is waiting")  # type: ignore[misc]
    return pids


@pytest.mark.parametrize(
    ("arguments", "code", "logged"),
    [
        (["exit", "0"], 0, "exit begins"),
        (["exit", "3"], 3, "exit begins"),
        (["raise", "no such gain"], 1, "RuntimeError: no such gain"),
    ],
)
def test_how_a_child_ends_is_reported_and_what_it_says_is_logged(
    client: LauncherClient, tmp_path: Path, arguments: list[str], code: int, logged: str
) -> None:
    client.spawn(child("one"), arguments, tmp_path / "one.log")
    reader = Reader(client)
    spawned, ended = reader.wait_for("spawned", "one"), reader.wait_for("exited", "one")
    assert ended["code"] == code
    assert ended["child"] == spawned["child"]
    assert logged in (tmp_path / "one.log").read_text(encoding="utf-8")


def test_a_child_is_named_and_marked_as_a_session_of_its_own(client: LauncherClient, tmp_path: Path) -> None:
    (pid,) = start(client, tmp_path, plane_sim=["wait"]).values()
    assert Path(f"/proc/{pid}/comm").read_text(encoding="utf-8").strip() == "plane_sim"
    assert os.getsid(pid) == client.pid != os.getsid(0), "Ctrl-C in a terminal must not reach it"


def test_a_signal_reaches_the_child_it_is_meant_for(client: LauncherClient, tmp_path: Path) -> None:
    pids = start(client, tmp_path, one=["wait"], two=["wait"])
    client.signal("one", signal.SIGKILL)
    client.signal("nobody", signal.SIGKILL)
    assert Reader(client).wait_for("exited", "one")["code"] == -signal.SIGKILL
    assert psutil.pid_exists(pids["two"])
    client.signal("one", signal.SIGKILL)  # it has ended: its number may be anybody's
    assert psutil.pid_exists(pids["two"])


def test_closing_ends_children_that_ignore_sigterm_and_such_that_are_stopped(
    client: LauncherClient, tmp_path: Path
) -> None:
    pids = start(client, tmp_path, deaf=["ignore-sigterm"], stopped=["wait"])
    client.signal("deaf", signal.SIGTERM)
    client.signal("stopped", signal.SIGSTOP)
    until(lambda: psutil.Process(pids["stopped"]).status() == psutil.STATUS_STOPPED, "stopped")
    client.close()
    assert not any(psutil.pid_exists(pid) for pid in pids.values())
    assert not client.alive()


def test_children_die_with_a_launcher_that_is_killed(client: LauncherClient, tmp_path: Path) -> None:
    pids = start(client, tmp_path, one=["ignore-sigterm"], two=["wait"])
    os.kill(client.pid, signal.SIGKILL)
    until(lambda: not any(psutil.pid_exists(pid) for pid in pids.values()), "the children are dead")
    assert not client.alive()
    client.spawn(child("three"), ["wait"], tmp_path / "three.log")  # nobody is there to hear it
    client.close()
    assert not (tmp_path / "three.log").exists()


def test_launcher_and_children_die_with_an_orchestrator_that_is_killed(nothing_survives: str, tmp_path: Path) -> None:
    script = Path(__file__).with_name("killed_orchestrator.py")
    with subprocess.Popen([sys.executable, script, tmp_path], env={**os.environ, **SEARCH_PATH}) as orchestrator:
        until(lambda: all(is_waiting(tmp_path / f"{name}.log") for name in ("one", "two")), "the children wait")
        assert len(marked_processes(nothing_survives)) == 4
        os.kill(orchestrator.pid, signal.SIGKILL)
        orchestrator.wait()
    until(lambda: not marked_processes(nothing_survives), "all are dead")


def test_all_start_at_the_same_signal(client: LauncherClient, tmp_path: Path) -> None:
    """The write end of the start pipe is the orchestrator's alone: no child holds it open."""
    pids = start(client, tmp_path, one=["wait"], two=["wait"])
    start_pipe = Path(f"/proc/self/fd/{client._start}").readlink()
    for pid in (client.pid, *pids.values()):
        writers = [
            entry
            for entry in Path(f"/proc/{pid}/fd").iterdir()
            if entry.readlink() == start_pipe and _writes(pid, entry.name)
        ]
        assert not writers
    client.start_all()
    client.start_all()


def _writes(pid: int, descriptor: str) -> bool:
    (flags,) = (
        line.split()[1]
        for line in Path(f"/proc/{pid}/fdinfo/{descriptor}").read_text(encoding="utf-8").splitlines()
        if line.startswith("flags:")
    )
    return bool(int(flags, 8) & os.O_WRONLY)


def test_the_launcher_loads_nothing_that_no_node_needs() -> None:
    """What it loads is in the memory of every node."""
    said = "import sys, swarmabs_run.orchestration.launcher; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True).stdout.split()
    assert "swarmabs_run.orchestration.launcher" in loaded
    assert not {"pydantic", "rich", "aiohttp", "matplotlib", "scipy"} & set(loaded)
