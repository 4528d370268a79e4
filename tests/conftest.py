"""What holds for all tests: the option ``--full``, a proof that a test leaves nothing behind, and an end of each."""

import faulthandler
import gc
import os
import signal
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import pytest
import rclpy
from hypothesis import settings
from tests.processes import MARK, marked_processes
from tests.systems import installed

from swarmabs_config.ports import DOMAIN_GAIN, LARGEST_DOMAIN, PORT_BASE
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.realtime.drives import DRIVES
from swarmabs_core.swarm_law import LAWS
from swarmabs_core.systems import SYSTEMS
from swarmabs_run.orchestration.network import FIRST_FREE, claimed_domain, dds_environment, profile_xml

# Property tests draw the same few examples every time, and take the time they need on a busy machine.
settings.register_profile("swarmabs", max_examples=30, deadline=None, derandomize=True, print_blob=True)
settings.load_profile("swarmabs")

# Known before the options are read; what it draws differs each time.
settings.register_profile("hours", max_examples=1000, derandomize=False)

_GONE_WITHIN = 5.0
"""Time, s, that the kernel may take to end a process which was killed, on a machine under full load."""
_PORTS = range(PORT_BASE, PORT_BASE + DOMAIN_GAIN * (LARGEST_DOMAIN + 3))
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD)
_SHARED_MEMORY = Path("/dev/shm")
_PATIENCE = 2.0
"""Multiple of a test's time after which it hangs where no signal reaches it, as in a library, or in clearing up."""
_STDERR = pytest.StashKey[int]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_STDERR] = os.dup(2)  # tests have another one, which is read only once they end


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Print where all threads of this process are, and end it, if a test does not end although its time is over."""
    mark = item.get_closest_marker("timeout")
    seconds = float(item.config.getini("timeout") if mark is None else mark.args[0])
    if seconds:
        faulthandler.dump_traceback_later(_PATIENCE * seconds, exit=True, file=item.config.stash[_STDERR])
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="also run the tests that take long")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--full"):
        return
    skip = pytest.mark.skip(reason="takes long; run it with --full")
    for item in items:
        if item.get_closest_marker("full") is not None:
            item.add_marker(skip)


def _own_ports() -> set[tuple[str, int]]:
    """Return the ports of the runs' range that this process holds, or that nobody holds who can be named."""
    return {
        (connection.type.name, connection.laddr.port)
        for connection in psutil.net_connections("inet")
        if connection.laddr and connection.laddr.port in _PORTS and connection.pid in {None, os.getpid()}
    }


def _descriptors() -> set[str]:
    """Return this process's pipes and sockets."""
    found = set()
    for entry in Path("/proc/self/fd").iterdir():
        try:
            target = str(entry.readlink())
        except OSError:  # the descriptor with which the folder itself was read
            continue
        if target.startswith(("pipe:", "socket:")):
            found.add(target)
    return found


def _shared_memory() -> set[str]:
    """Return the files of shared memory that a test has to take away.

    No run uses the semaphores of Python's multiprocessing, and virtual fleets that other processes run have their disks
    there. The tracing library of ROS makes its files for every program
    with rclpy, also for a node that a test starts by itself or kills; a command leaves none (`tests/system`).
    """
    if not _SHARED_MEMORY.is_dir():
        return set()
    names = {path.name for path in _SHARED_MEMORY.iterdir()}
    return {name for name in names if not name.startswith(("sem.mp-", "lttng-ust-wait-", "virtual-"))}


def _things() -> dict[str, set[Any]]:
    """Return what a test may make and has to take away again."""
    return {
        "children": {child.pid for child in psutil.Process().children(recursive=True)},
        "ports": _own_ports(),
        "shared memory": _shared_memory(),
        "pipes and sockets": _descriptors(),
    }


def _settings() -> dict[str, object]:
    """Return what a test may change and has to restore."""
    return {
        "environment": {name: text for name, text in os.environ.items() if name != "PYTEST_CURRENT_TEST"},
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
        settings, things = _settings(), _things()
        yield mark
        assert _settings() == settings, "the test changes what is not its own"
        deadline = time.monotonic() + _GONE_WITHIN
        while (left := _left(things, mark)) and time.monotonic() < deadline:
            time.sleep(0.02)
        for pid in marked_processes(mark):  # the next test shall not suffer
            os.kill(pid, signal.SIGKILL)
        assert not left, f"the test leaves behind: {left}"
        assert not list(temporary.iterdir()), "the test leaves temporary files behind"


def _left(before: dict[str, set[Any]], mark: str) -> dict[str, object]:
    """Return what is there now and was not before."""
    left: dict[str, object] = {name: new for name, found in _things().items() if (new := found - before[name])}
    processes = marked_processes(mark)
    return {**left, "processes": processes} if processes else left


@pytest.fixture(scope="session")
def ros_network(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Claim a ROS domain on loopback, and give the environment of those who take part in it."""
    with claimed_domain() as domain:
        profile = tmp_path_factory.mktemp("network") / "fastdds.xml"
        profile.write_text(profile_xml(domain, participant=FIRST_FREE), encoding="utf-8")
        yield dds_environment(domain, str(profile))


@pytest.fixture
def ros(ros_network: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let this process take part in ROS; the test calls `rclpy.init` with what it needs."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "ros_log"))
    for name, text in ros_network.items():
        monkeypatch.setenv(name, text)
    yield
    rclpy.try_shutdown()
    # Fast DDS can deadlock when a participant ends beside another one of the process (eProsima/Fast-DDS#6193).
    if _participates():
        gc.collect()
    assert not _participates(), "the test leaves a node behind"


def _participates() -> bool:
    """Tell whether a participant of this process listens."""
    return any(held.laddr.port in _PORTS for held in psutil.Process().net_connections("udp") if held.laddr)


@contextmanager
def temporary_packages(*folders: Path) -> Iterator[None]:
    """Restore the search path at the end, and forget what was loaded from packages in these folders."""
    path = [*sys.path]
    for registry in (CONTROLLERS, LAWS, DRIVES, SYSTEMS):
        registry.forget()
    yield
    sys.path[:] = path
    for registry in (CONTROLLERS, LAWS, DRIVES, SYSTEMS):
        registry.forget()
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", "")).startswith(tuple(map(str, folders))):
            del sys.modules[name]


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give a folder in which packages can be installed; what is imported from it is forgotten after the test."""
    folder = tmp_path / "packages"
    folder.mkdir()
    with temporary_packages(folder):
        monkeypatch.syspath_prepend(folder)
        yield folder


@pytest.fixture
def systems(packages: Path) -> Path:
    """Give a folder of the search path in which the parent systems of `tests.systems` are installed."""
    installed(packages)
    return packages
