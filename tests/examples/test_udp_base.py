"""The example package of a vendor's drive: installed as a user installs it, it talks to a base on loopback."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from math import nan
from pathlib import Path
from struct import pack, unpack
from typing import Any

import pytest
from tests.docs.pages import ROOT

from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.drives import DRIVES, Body, Measurement, Reporting

EXAMPLE = ROOT / "examples" / "udp_base"
BODY = Body(1, Kind.SINGLE_INTEGRATOR, Schedule(10_000_000), 0.5)
NOW = 1_700_000_000_000_000_000

pytestmark = pytest.mark.timeout(120)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the example, without network, into a folder; return the folder."""
    folder = tmp_path_factory.mktemp("installed")
    source = tmp_path_factory.mktemp("source") / "udp_base"  # pip builds where the source is
    shutil.copytree(EXAMPLE, source)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--no-deps", "--no-build-isolation"]
    words = [*pip, "--no-index", "--target", str(folder), str(source)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def base() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        found.settimeout(10.0)
        yield found


@pytest.fixture
def drive(installed: Path, base: socket.socket, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.syspath_prepend(installed)
    for cache in ("_loaded", "_packages"):
        monkeypatch.setattr(DRIVES, cache, {})
    made = DRIVES.make("udp_base", {"address": "127.0.0.1", "port": base.getsockname()[1]}, BODY)
    assert DRIVES.package("udp_base") == ("swarmabs-udp-base", "1.0.0")
    yield made
    made._socket.close()  # type: ignore[attr-defined]
    sys.modules.pop("swarmabs_udp_base", None)


def test_commands_arrive_and_the_newest_good_state_counts(drive: Any, base: socket.socket) -> None:
    assert drive.read(NOW) is None
    drive.write(0.25, NOW)
    drive.stop()
    told, robot = base.recvfrom(64)
    assert [unpack("<d", told), unpack("<d", base.recv(64))] == [(0.25,), (0.0,)]
    states = [pack("<qdd", 1, 0.1, 0.2), pack("<qdd", 2, 0.3, -0.4)]
    bad = [b"", b"hello", pack("<qdd", 3, nan, 0.0), pack("<qdd", 0, 9.0, 9.0), bytes(1000)]
    for datagram in (*states, *bad):
        base.sendto(datagram, robot)
    assert drive.read(NOW) == Measurement(NOW - 2_000_000, 0.3, -0.4)  # loopback has delivered when sendto returns
    assert isinstance(drive, Reporting)
    assert drive.report() == (("datagrams refused", "5"),)
    assert drive.read(NOW + 1) == Measurement(NOW - 2_000_000, 0.3, -0.4)


def test_datagrams_of_others_are_not_heard(drive: Any, base: socket.socket) -> None:
    drive.stop()
    _, robot = base.recvfrom(64)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as intruder:
        intruder.sendto(pack("<qdd", 1, 0.1, 0.2), robot)
    assert drive.read(NOW) is None


def test_a_base_that_is_not_there_is_only_silence(drive: Any, base: socket.socket) -> None:
    base.close()
    for _ in range(3):  # the kernel reports the refused datagram at the next call
        drive.write(0.1, NOW)
        assert drive.read(NOW) is None
    drive.stop()


def test_an_address_that_is_none_is_refused(drive: Any) -> None:
    with pytest.raises(InputError, match=r"drive\.address: '::1' cannot be used"):
        DRIVES.make("udp_base", {"address": "::1"}, BODY)
