"""The example packages, a parent controller and a vendor's drive: installed as users do, they serve runs and robots."""

import json
import math
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from struct import pack, unpack
from textwrap import dedent
from typing import Any

import pytest
from tests.plugin_packages import SCALED, install
from tests.processes import ROOT

from swarmabs_config.scenario import load_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.drives import DRIVES, Body, Drive, Measurement, Reporting
from swarmabs_run.simulation import simulate

SLIDING_MODE, UDP_BASE = (ROOT / "examples" / name for name in ("sliding_mode", "udp_base"))
SCENARIO = SLIDING_MODE / "sliding_mode.yaml"
LONGEST = 100.0
BODY = Body(1, Kind.SINGLE_INTEGRATOR, Schedule(10_000_000), 0.5)
NOW = 1_700_000_000_000_000_000


@pytest.mark.system
def test_the_angle_follows_within_the_boundary_layer(packages: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within the layer |s| falls below layer D/reach and |e| below that divided by the slope."""
    monkeypatch.syspath_prepend(SLIDING_MODE)
    install(packages, "controller", "sliding_mode", "", target="swarmabs_sliding_mode:SLIDING_MODE")
    layer, reach, slope = 0.1, 0.5, 2.0
    unknown = 0.2 + 0.01 + 0.02  # N m: the scenario's disturbance, and the friction g1 and g4 that the law leaves out
    bound = layer * unknown / (reach * slope)
    kinds = ("single_integrator: 4", "double_integrator: 4", "single_integrator: 5, double_integrator: 5")
    for overrides in ([], *([f"swarm={{generate: {{{kind}}}}}"] for kind in kinds)):
        run = simulate(load_scenario(SCENARIO, overrides))
        errors = [abs(have - 0.3 * math.sin(0.5 * time)) for time, have in zip(run.time, run.angle, strict=True)]
        assert errors[0] == pytest.approx(0.1)
        assert 0.5 * bound < max(errors[500:]) < bound  # the disturbance is felt, and no more than that


@pytest.fixture
def base() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        found.settimeout(10.0)
        yield found


@pytest.fixture
def drive(packages: Path, base: socket.socket, monkeypatch: pytest.MonkeyPatch) -> Iterator[Drive]:
    monkeypatch.syspath_prepend(UDP_BASE)
    install(packages, "drive", "udp_base", "", target="swarmabs_udp_base:UDP_BASE")
    made: Any = DRIVES.make("udp_base", {"address": "127.0.0.1", "port": base.getsockname()[1]}, BODY)
    yield made
    made.socket.close()
    sys.modules.pop("swarmabs_udp_base", None)


def test_commands_arrive_and_the_newest_good_state_counts(drive: Drive, base: socket.socket) -> None:
    assert drive.read(NOW) is None
    drive.write(0.25, NOW)
    drive.stop()
    told, robot = base.recvfrom(64)
    assert [unpack("<d", told), unpack("<d", base.recv(64))] == [(0.25,), (0.0,)]
    states = [pack("<qdd", 1, 0.1, 0.2), pack("<qdd", 2, 0.3, -0.4)]
    bad = [b"", b"hello", pack("<qdd", 3, math.nan, 0.0), pack("<qdd", 0, 9.0, 9.0), bytes(1000)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.sendto(states[0], robot)
    assert drive.read(NOW) is None
    for datagram in (*states, *bad):
        base.sendto(datagram, robot)
    assert drive.read(NOW) == Measurement(NOW - 2_000_000, 0.3, -0.4)  # loopback has delivered when sendto returns
    assert isinstance(drive, Reporting)
    assert drive.report() == (("datagrams rejected", "5"),)
    assert drive.read(NOW + 1) == Measurement(NOW - 2_000_000, 0.3, -0.4)


def test_a_missing_base_is_only_silence_and_a_bad_address_is_refused(drive: Drive, base: socket.socket) -> None:
    base.close()
    for _ in range(3):  # the kernel reports the refused datagram at the next call
        drive.write(0.1, NOW)
        assert drive.read(NOW) is None
    drive.stop()
    with pytest.raises(InputError, match=r"drive\.address: '::1' cannot be used"):
        DRIVES.make("udp_base", {"address": "::1"}, BODY)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the examples, without network, into a folder; return the folder."""
    folder, source = tmp_path_factory.mktemp("installed"), tmp_path_factory.mktemp("source")
    for example in (SLIDING_MODE, UDP_BASE):
        shutil.copytree(example, source / example.name)  # pip builds where the source is
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--no-deps", "--no-build-isolation"]
    words = [*pip, "--no-index", "--target", str(folder), *map(str, source.iterdir())]
    subprocess.run(words, stdout=subprocess.DEVNULL, timeout=LONGEST, check=True)
    return folder


def python(*words: object, cwd: Path, path: tuple[Path, ...]) -> str:
    """Run Python with folders of packages in the search path; return what it prints."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((*map(str, path), os.environ["PYTHONPATH"]))}
    command = [sys.executable, *map(str, words)]
    return subprocess.check_output(command, env=environment, cwd=cwd, text=True, timeout=LONGEST)


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize("extra", [(), ("--agents-per-process", "2")], ids=["apart", "together"])
def test_processes_and_simulation_agree(installed: Path, tmp_path: Path, extra: tuple[str, ...]) -> None:
    said = "the module of the law is imported"
    install(tmp_path / "laws", "law", "scaled", f"import sys\nprint({said!r}, file=sys.stderr)\n{dedent(SCALED)}")

    def swarm(*words: object) -> Any:
        path = (installed, tmp_path / "laws")
        return json.loads(python("-m", "swarmabs_cli", *words, cwd=tmp_path, path=path))

    words = (SCENARIO, "--duration", "1.5", "--set", "swarm.law={type: scaled, factor: 0.5}", "--json")
    run = swarm("run", *words, *extra, "-o", "run")
    assert (run["status"], run["steps"]) == ("ok", 150)
    assert run["digest"] == swarm("simulate", *words, "-o", "simulated")["digest"]
    logs = sorted((tmp_path / "run" / "logs").glob("*.log"))
    assert [log.name for log in logs if said in log.read_text(encoding="utf-8")] == ["launcher.log"]  # before the forks
    assert swarm("simulate", "run", "-o", "again", "--json")["digest"] == run["digest"]
    assert {"swarmabs-sliding-mode", "test-scaled"} <= swarm("info", "run", "--json")["versions"].keys()
    schema = swarm("scenario", "schema")
    assert "sliding_mode" in json.dumps(schema["properties"]["controller"])
    program = "from swarmabs_core.realtime.drives import DRIVES; print(DRIVES.package('udp_base'))"
    assert python("-c", program, cwd=tmp_path, path=(installed,)) == "('swarmabs-udp-base', '1.0.0')\n"
