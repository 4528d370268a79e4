"""What holds for all tests: the option ``--full``, and a proof that a test leaves nothing behind."""

from __future__ import annotations

import os
import signal
import tempfile
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from swarmabs_bringup.orchestration.domain import DOMAIN_GAIN, LARGEST_DOMAIN, PORT_BASE

MARK = "SWARMABS_TEST_MARK"
"""Environment variable that every process which a test starts inherits."""

_GONE_WITHIN = 5.0
"""Time, s, that the kernel may take to end a process which was killed, on a machine under full load."""
_PORTS = range(PORT_BASE, PORT_BASE + DOMAIN_GAIN * (LARGEST_DOMAIN + 3))
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD)
_SHARED_MEMORY = Path("/dev/shm")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="also run the tests that take long")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--full"):
        return
    skip = pytest.mark.skip(reason="takes long; run it with --full")
    for item in items:
        if item.get_closest_marker("full") is not None:
            item.add_marker(skip)


def marked_processes(mark: str) -> dict[int, str]:
    """Return the names of the living processes that carry a mark in their environment, by process id."""
    needle = f"{MARK}={mark}".encode()
    found = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit() or int(folder.name) == os.getpid():
            continue
        try:
            if needle in (folder / "environ").read_bytes().split(b"\0"):
                found[int(folder.name)] = (folder / "comm").read_text().strip()
        except OSError:  # it has ended, or is another user's
            continue
    return found


def _own_ports() -> set[tuple[str, int]]:
    """Return the ports of the runs' range that this process holds, or that nobody holds who can be named."""
    return {
        (connection.type.name, connection.laddr.port)
        for connection in psutil.net_connections("inet")
        if connection.laddr and connection.laddr.port in _PORTS and connection.pid in {None, os.getpid()}
    }


def _descriptors() -> dict[str, str]:
    """Return this process's pipes and sockets by file descriptor."""
    found = {}
    for entry in Path("/proc/self/fd").iterdir():
        try:
            target = str(entry.readlink())
        except OSError:  # the descriptor with which the folder itself was read
            continue
        if target.startswith(("pipe:", "socket:")):
            found[entry.name] = target
    return found


def _state() -> dict[str, object]:
    """Return everything outside of a test's own folder that it could change and must not."""
    return {
        "environment": {name: text for name, text in os.environ.items() if name != "PYTEST_CURRENT_TEST"},
        "children": {child.pid for child in psutil.Process().children(recursive=True)},
        "ports": _own_ports(),
        "shared memory": {path.name for path in _SHARED_MEMORY.iterdir()} if _SHARED_MEMORY.is_dir() else set(),
        "pipes and sockets": _descriptors(),
        "signal handlers": {number: signal.getsignal(number) for number in _SIGNALS},
        "working directory": Path.cwd(),
    }


@pytest.fixture
def nothing_survives(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Prove that no process, port, shared memory, temporary file or variable of a test is there after it.

    Yields the mark that the test's processes carry in their environment.
    """
    mark = uuid.uuid4().hex
    temporary = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(MARK, mark)
        for name in ("TMPDIR", "ROS_LOG_DIR"):
            patch.setenv(name, str(temporary))
        patch.setattr(tempfile, "tempdir", str(temporary))
        before = _state()
        yield mark
        deadline = time.monotonic() + _GONE_WITHIN
        while (left := _left(before, mark)) and time.monotonic() < deadline:
            time.sleep(0.02)
        for pid in marked_processes(mark):  # the next test shall not suffer
            os.kill(pid, signal.SIGKILL)
        assert not left, f"the test leaves behind: {left}"
        assert not list(temporary.iterdir()), "the test leaves temporary files behind"


def _left(before: dict[str, object], mark: str) -> dict[str, object]:
    after = _state()
    left: dict[str, object] = {name: (before[name], value) for name, value in after.items() if value != before[name]}
    processes = marked_processes(mark)
    return {**left, "processes": processes} if processes else left
