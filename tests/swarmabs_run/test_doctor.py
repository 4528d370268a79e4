"""What is checked of a machine, and what is said where something is wrong."""

import importlib
import re
import resource
import shutil
import socket
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from swarmabs_run import doctor
from swarmabs_run.doctor import CHECKS, examine
from swarmabs_run.orchestration import network


def broken_import(module: str) -> Callable[[str], object]:
    real = importlib.import_module

    def find(name: str) -> object:
        if name.startswith(module):
            raise ImportError(f"no module {name}")
        return real(name)

    return find


def test_this_machine_can_run_swarms() -> None:
    findings = examine()
    assert not [finding for finding in findings if finding.verdict == "bad" or "\n" in finding.text]
    assert len({finding.check for finding in findings}) == len(findings)


def refuse(*_: object) -> None:
    raise OSError(101, "Network is unreachable")


FULL = shutil.disk_usage("/")._replace(free=10**6)
NO_WAIT_SET = types.SimpleNamespace(rclpy_implementation=types.SimpleNamespace())


@pytest.mark.parametrize(
    ("where", "what", "instead", "check", "verdict", "remedy"),
    [
        (doctor.importlib, "import_module", broken_import("rclpy"), "rclpy", "bad", "swarm again"),
        (doctor.importlib, "import_module", lambda _: NO_WAIT_SET, "rclpy", "bad", "source ROS 2 Jazzy"),
        (doctor.importlib, "import_module", broken_import("swarmabs_msgs"), "messages", "bad", "build"),
        (doctor.importlib, "import_module", lambda _: NO_WAIT_SET, "messages", "bad", "too old: .*build"),
        (doctor, "builtin_scenarios", dict, "scenarios", "bad", "missing; build"),
        (doctor, "builtin_scenarios", lambda: {"x": Path("/nowhere")}, "scenarios", "bad", "build"),
        (socket.socket, "sendto", refuse, "loopback", "bad", "ip link set lo up"),
        (socket.socket, "sendto", refuse, "ROS domain", "bad", "ip link set lo up"),
        (network, "first_taken", lambda _: 7400, "ROS domain", "bad", "end other runs"),
        (resource, "getrlimit", lambda _: (1023, 4096), "open files", "note", "limit 1023; .*ulimit -n 1024"),
        (resource, "getrlimit", lambda _: (1024, 4096), "open files", "ok", "limit 1024"),
        (resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2, "open files", "ok", "no limit"),
        (shutil, "disk_usage", lambda _: FULL, "disk", "note", "only 1 MiB free"),
        (shutil, "disk_usage", lambda _: FULL._replace(free=3 * 2**30), "disk", "ok", "3.0 GiB free"),
    ],
)
def test_what_is_found_comes_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, where: Any, what: str, instead: object, check: str, verdict: str, remedy: str
) -> None:
    monkeypatch.setattr(where, what, instead)
    judged, text = CHECKS[check]()
    assert judged == verdict
    assert re.search(remedy, text)


def test_small_buffers_are_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "BUFFERS", tmp_path)
    assert CHECKS["socket buffers"]() == ("ok", "at least 4 MiB")
    larger = "sysctl -w net.core.rmem_max=4194304 net.core.wmem_max=419"
    for received, sent, verdict, told in (("4194303", "1", "note", larger), ("4194304", "?", "ok", "at least 4 MiB")):
        (tmp_path / "rmem_max").write_text(received)
        (tmp_path / "wmem_max").write_text(sent)
        judged, text = CHECKS["socket buffers"]()
        assert judged == verdict and told in text
