"""Bundles: the same bytes every time, nothing half-written, parameters as rclpy reads them."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest
import rclpy
from tests.processes import SEARCH_PATH
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, contents, deployed, edited, example

from swarmabs_bag.recorder import realtime as recorder
from swarmabs_config.fleet.loader import load_fleet
from swarmabs_config.fleet.participants import node_plans
from swarmabs_config.graph import RECORDER
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.parameters import resolve
from swarmabs_fleet.bundle import deploy
from swarmabs_fleet.parameters import parameters


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_same_fleet_gives_the_same_bytes(name: str, tmp_path: Path) -> None:
    keys = None if name == "lan" else tmp_path / "keys"
    first = contents(deployed(example(name), tmp_path / "first", keys))
    assert contents(deployed(example(name), tmp_path / "second", keys)) == first
    if keys is not None:
        other = contents(deployed(example(name), tmp_path / "third", tmp_path / "others"))
        changed = {path for path in first if other[path] != first[path]}
        lists = {path for path in changed if path.endswith(("SHA256SUMS", "manifest.json"))}
        assert changed - lists
        assert all("/keystore/" in path or "/wireguard/" in path for path in changed - lists)


@pytest.mark.parametrize("name", ["lan", "tunnel"])
def test_the_recorder_takes_what_it_is_told(name: str) -> None:
    """Also where robots have bodies or limits of their own."""
    loaded = example(name)
    (node,) = (node for node in node_plans(loaded.fleet) if node.name == RECORDER)
    values = parameters(loaded, node)
    taken = resolve(recorder.PARAMETERS, values, owner="recorder")
    if name == "tunnel":
        assert (taken["driven"], taken["own_limits"]) == ((1, 2, 3), (3,))


def test_a_robot_more_changes_no_other_robot(tmp_path: Path) -> None:
    lan = EXAMPLES["lan"].read_text(encoding="utf-8")
    host = "  - {name: robot-5, address: 192.168.10.15}\n"
    robot = "  - {id: 5, host: robot-5, kind: single_integrator, mass: 0.4, drive: {type: simulated, position: 0.2}}\n"
    more = edited(
        tmp_path / "lan.yaml",
        lan,
        ("robots:", f"{host}swarm_mass: 4.0\nrobots:"),
        ("coordinators:", f"{robot}coordinators:"),
    )
    planned = edited(tmp_path / "planned.yaml", lan, ("robots:", "swarm_mass: 4.0\nrobots:"))
    before = deployed(load_fleet(planned), tmp_path / "before")
    after = deployed(load_fleet(more), tmp_path / "after")
    for number in range(1, 5):
        assert contents(before / f"robot-{number}") == contents(after / f"robot-{number}")
    assert contents(before / "base") != contents(after / "base")


def test_modes_and_sums_are_those_of_the_manifest(tmp_path: Path) -> None:
    umask = os.umask(0o002)
    try:
        output = deployed(example("sros2"), tmp_path / "out", tmp_path / "keys")
    finally:
        os.umask(umask)
    for bundle in (output / "base", output / "arm-1", output / "arm-2"):
        done = subprocess.run(["sha256sum", "--check", "--quiet", "--strict", "SHA256SUMS"], cwd=bundle, check=False)
        assert done.returncode == 0
        listed = json.loads((bundle / "manifest.json").read_text())["files"]
        found = {path: content for path, content in contents(bundle).items() if path != "manifest.json"}
        assert {path: facts["sha256"] for path, facts in listed.items()} == {
            path: sha256(content).hexdigest() for path, content in found.items()
        }
        for path, facts in listed.items():
            mode = stat.S_IMODE((bundle / path).stat().st_mode)
            assert f"{mode:04o}" == facts["mode"]
            assert mode == (0o600 if path.startswith("keystore/") else 0o755 if path.endswith(".sh") else 0o644)
        assert stat.S_IMODE((bundle / "keystore").stat().st_mode) == 0o700
    for path in (tmp_path / "keys").rglob("*"):
        assert not stat.S_IMODE(path.stat().st_mode) & 0o077


def test_an_output_that_is_not_empty_is_refused_before_keys_are_made(tmp_path: Path) -> None:
    output = tmp_path / "out"
    output.mkdir()
    (output / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty; name another with -o"):
        deploy(example("tunnel"), output, tmp_path / "keys")
    assert contents(tmp_path) == {"out/mine.txt": b"mine"}
    (output / "mine.txt").unlink()
    deploy(example("tunnel"), output, tmp_path / "keys")
    assert (output / "base" / "manifest.json").is_file()


def test_what_fails_in_the_middle_leaves_no_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[Path] = []
    write = Path.write_bytes

    def full(self: Path, content: bytes) -> int:
        written.append(self)
        if len(written) == 12:
            raise OSError(28, "No space left on device")
        return write(self, content)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(RunError, match="No space left on device; free space"):
            deploy(example("lan"), tmp_path / "out", None)
    assert list(tmp_path.iterdir()) == []
    deploy(example("lan"), tmp_path / "out", None)


@pytest.mark.parametrize(
    ("name", "keys", "words"),
    [
        ("tunnel", None, "--keys DIR"),
        ("sros2", None, "--keys DIR"),
        ("lan", "keys", "security is none"),
        ("tunnel", "out/keys", "copied to robots"),
        ("tunnel", "out", "copied to robots"),
    ],
)
def test_keys_where_they_cannot_be(name: str, keys: str | None, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words):
        deploy(example(name), tmp_path / "out", None if keys is None else tmp_path / keys)
    assert list(tmp_path.iterdir()) == []


def test_keys_that_others_can_read_are_refused(tmp_path: Path) -> None:
    keys = tmp_path / "keys" / "floor"
    keys.mkdir(parents=True, mode=0o755)
    keys.chmod(0o755)
    with pytest.raises(InputError, match="chmod 700"):
        deploy(example("tunnel"), tmp_path / "out", tmp_path / "keys")
    keys.chmod(0o700)
    deploy(example("tunnel"), tmp_path / "out", tmp_path / "keys")
    (keys / "wireguard" / "cart-2.key").chmod(0o644)
    with pytest.raises(InputError, match=r"cart-2\.key; take it for known"):
        deploy(example("tunnel"), tmp_path / "again", tmp_path / "keys")
    assert not (tmp_path / "again").exists()


@pytest.mark.parametrize("content", ["", "not base64!", "c2hvcnQ="])
def test_a_damaged_key_of_a_tunnel_is_named_with_the_remedy(tmp_path: Path, content: str) -> None:
    keys = tmp_path / "keys"
    deploy(example("tunnel"), tmp_path / "out", keys)
    (keys / "floor" / "wireguard" / "cart-2.key").write_text(content)
    with pytest.raises(InputError, match=r"cart-2\.key holds no private key; restore it"):
        deploy(example("tunnel"), tmp_path / "again", keys)
    assert not (tmp_path / "again").exists()


def test_parameters_are_what_a_node_of_ros_reads(tmp_path: Path, ros: None) -> None:
    robot = "damping: 0.8, drive: {type: simulated, position: -0.1}}"
    plugin = (
        "damping: 1.0e-7, limits: {lane: 0.3}, drive: {type: plugin, name: rail.x, settings: "
        "{port: '0', speed: 3, bus.rate: 1.5, on: true, axes: [1.5, 2.0], words: ['1', no]}}}"
    )
    fleet = load_fleet(edited(tmp_path / "f.yaml", ONE_HOST, (robot, plugin)))
    output = deployed(fleet, tmp_path / "out")
    rclpy.init(args=["--ros-args", "--params-file", str(output / "base" / "nodes" / "agent_002.yaml")])
    node = rclpy.create_node("agent_002", automatically_declare_parameters_from_overrides=True)
    given = {name: node.get_parameter(name).value for name in node.get_parameters_by_prefix("")}
    node.destroy_node()
    assert {name: given[name] for name in ("epoch_ns", "period_ns", "agent_id", "kind")} == {
        "epoch_ns": 1767225600 * 10**9,
        "period_ns": 10_000_000,
        "agent_id": 2,
        "kind": "double_integrator",
    }
    assert given["damping"] == 1e-7
    assert given["lane_margin"] == pytest.approx(0.2)
    assert list(given["gains.kd"]) == [5.0, 5.0]
    drive = {name: value for name, value in given.items() if name.startswith("drive.")}
    assert list(drive.pop("drive.axes")) == [1.5, 2.0]
    assert drive == {
        "drive.type": "rail.x",
        "drive.port": "0",
        "drive.speed": 3,
        "drive.bus.rate": 1.5,
        "drive.on": True,
        "drive.words": ["1", "no"],
    }


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_file_of_parameters_is_read_by_ros(name: str, tmp_path: Path, ros: None) -> None:
    output = deployed(example(name), tmp_path / "out", None if name == "lan" else tmp_path / "keys")
    files = sorted(output.glob("*/nodes/*.yaml"))
    assert len(files) >= 5
    for file in files:
        context = rclpy.Context()
        rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context)
        node = rclpy.create_node(file.stem, context=context, automatically_declare_parameters_from_overrides=True)
        names = set(node.get_parameters_by_prefix(""))
        node.destroy_node()
        context.shutdown()
        assert {"epoch_ns", "period_ns", "clock_tolerance"} <= names or file.stem == "discovery_server"


def test_an_output_that_cannot_be_written(tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o555)
    program = (
        "import sys; from tests.privileges import respect_permissions; from swarmabs_cli import main; "
        "respect_permissions(); sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", program, "deploy", EXAMPLES["lan"], "-o", closed / "out"]
    environment = {**os.environ, **SEARCH_PATH}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines()[-1].endswith("cannot be used: Permission denied; choose another with -o")
    assert list(closed.iterdir()) == []
