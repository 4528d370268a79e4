"""What is checked of a machine, and what is said where something is wrong."""

from __future__ import annotations

import importlib
import resource
import shutil
import socket
from collections.abc import Callable

import pytest

from swarmabs_run import doctor
from swarmabs_run.doctor import Finding, examine


def named(check: str) -> Finding:
    (found,) = [finding for finding in examine() if finding.check == check]
    return found


def broken_import(module: str) -> Callable[[str], object]:
    real = importlib.import_module

    def find(name: str) -> object:
        if name.startswith(module):
            raise ImportError(f"no module {name}")
        return real(name)

    return find


def test_this_machine_can_run_swarms() -> None:
    findings = examine()
    assert not [finding for finding in findings if finding.verdict == "bad"]
    assert len({finding.check for finding in findings}) == len(findings)
    assert all("\n" not in finding.text for finding in findings)


@pytest.mark.parametrize(("module", "check"), [("rclpy", "rclpy"), ("swarmabs_msgs", "messages")])
def test_what_is_missing_is_bad_and_has_a_remedy(module: str, check: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor.importlib, "import_module", broken_import(module))
    assert named(check).verdict == "bad"
    assert "swarm" in named(check).text or "build" in named(check).text


def test_an_rclpy_that_has_changed_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("rclpy.impl.implementation_singleton.rclpy_implementation.WaitSet")
    assert named("rclpy") == Finding(
        "rclpy", "note", "cannot be waited on directly; nodes need the parameter receive:=executor"
    )


def test_missing_scenarios_are_bad(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "builtin_scenarios", dict)
    assert named("scenarios").verdict == "bad"


def test_no_udp_is_bad(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(101, "Network is unreachable")

    monkeypatch.setattr(socket.socket, "sendto", refuse)
    assert named("loopback").verdict == "bad"
    assert "lo" in named("loopback").text


def test_few_descriptors_and_a_full_disk_are_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (256, 4096))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10**9, 10**9 - 10**6, 10**6))
    assert (named("open files").verdict, named("disk").verdict) == ("note", "note")
    assert "ulimit -n" in named("open files").text
