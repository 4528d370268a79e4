"""Bundles: the same bytes every time, nothing half-written, parameters as rclpy reads them."""

import json
import stat
import subprocess
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import pytest
import rclpy
from tests.privileges import respecting_permissions
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, contents, deployed, edited, example, uses_keys

from swarmabs_bag.recorder import realtime as recorder
from swarmabs_config.fleet.loader import load_fleet
from swarmabs_config.fleet.participants import node_plans
from swarmabs_config.graph import OBSERVER, RECORDER
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.parameters import resolve
from swarmabs_fleet.bundle import deploy, host_bundle
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_fleet.parameters import parameters
from swarmabs_ros.parameters import table_of


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_same_fleet_gives_the_same_bytes(name: str, examples: dict[str, Path], tmp_path: Path) -> None:
    first, keys = contents(examples[name]), examples[name].parent / "keys"
    if not uses_keys(name):
        assert contents(deployed(example(name), tmp_path / "second")) == first
        return
    assert contents(deployed(example(name), tmp_path / "second", keys)) == first
    other = contents(deployed(example(name), tmp_path / "third", tmp_path / "others"))
    changed = {path for path in first if other[path] != first[path]}
    lists = {path for path in changed if path.endswith(("SHA256SUMS", "manifest.json"))}
    assert changed - lists
    assert all("/keystore/" in path or "/wireguard/" in path for path in changed - lists)


@pytest.mark.parametrize(("name", "own"), [("lan", ((), ())), ("tunnel", ((1, 2, 3), (3,)))])
def test_the_recorder_takes_what_it_is_told(name: str, own: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    """Also where robots have bodies or limits of their own."""
    loaded = example(name)
    plans = {node.name: node for node in node_plans(loaded.fleet)}
    taken = resolve(table_of({}, (), recorder.PARAMETERS), parameters(loaded, plans[RECORDER]), owner="recorder")
    assert [name for name, node in plans.items() if "memory" in parameters(loaded, node)] == [OBSERVER]
    assert (taken["driven"], taken["own_limits"]) == own


def test_each_node_is_told_of_its_pair() -> None:
    """Of a pair of recorders each has the folder of its host; a fleet without standbys knows of none."""

    def told(name: str) -> dict[str, tuple[object, ...]]:
        loaded = example(name)
        parameters_of = {node.name: parameters(loaded, node) for node in node_plans(loaded.fleet)}
        return {node: tuple(values.get(key) for key in ("pair", "paired")) for node, values in parameters_of.items()}

    assert {node: values for node, values in told("standby").items() if not node.startswith("agent_")} == {
        "plane_driver": (None, None),
        "abstraction_observer": ("primary", True),
        "abstraction_observer_standby": ("standby", True),
        "parent_controller": ("primary", True),
        "parent_controller_standby": ("standby", True),
        "recorder": ("primary", True),
        "recorder_standby": ("standby", True),
    }
    assert told("standby")["agent_004"] == (None, True)
    assert {values[1] for values in told("lan").values()} == {None, False}
    loaded = example("standby")
    bags = [parameters(loaded, node)["bags"] for node in node_plans(loaded.fleet) if node.kind == RECORDER]
    assert bags == ["/var/lib/swarmabs-pair"] * 2
    assert "scenario.yaml" in host_bundle(loaded, HostPlan(loaded.fleet, "spare"), None)


def test_a_robot_more_changes_no_other_robot(tmp_path: Path) -> None:
    lan = EXAMPLES["lan"].read_text(encoding="utf-8")
    host = "  - {name: robot-5, address: 192.168.10.15}\n"
    robot = "  - {id: 5, host: robot-5, kind: single_integrator, mass: 0.4, drive: {type: simulated, position: 0.2}}\n"
    planned = edited(tmp_path / "planned.yaml", lan, ("robots:", "swarm_mass: 4.0\nrobots:"))
    before = deployed(load_fleet(planned), tmp_path / "before")
    changes = (("robots:", f"{host}swarm_mass: 4.0\nrobots:"), ("coordinators:", f"{robot}coordinators:"))
    after = deployed(load_fleet(edited(tmp_path / "lan.yaml", lan, *changes)), tmp_path / "after")
    for number in range(1, 5):
        assert contents(before / f"robot-{number}") == contents(after / f"robot-{number}")
    assert contents(before / "base") != contents(after / "base")


def test_modes_and_sums_are_those_of_the_manifest(examples: dict[str, Path]) -> None:
    output = examples["sros2"]
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
    for path in (output.parent / "keys").rglob("*"):
        assert not stat.S_IMODE(path.stat().st_mode) & 0o077


def test_an_output_that_is_not_empty_or_cannot_be_written_is_refused_before_keys_are_made(tmp_path: Path) -> None:
    output = tmp_path / "out"
    output.mkdir()
    (output / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty; choose another with -o"):
        deploy(example("tunnel"), output, tmp_path / "keys")
    assert contents(tmp_path) == {"out/mine.txt": b"mine"}
    (output / "mine.txt").unlink()
    deploy(example("tunnel"), output, tmp_path / "keys")
    assert (output / "base" / "manifest.json").is_file()
    (tmp_path / "closed").mkdir(mode=0o555)
    with pytest.raises(InputError, match="cannot be used: Permission denied; choose another with -o"):
        respecting_permissions(lambda: deploy(example("lan"), tmp_path / "closed" / "out", None))
    assert list((tmp_path / "closed").iterdir()) == []


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


def test_keys_where_they_cannot_be(tmp_path: Path) -> None:
    for name, keys, words in (
        ("tunnel", None, "--keys DIR"),
        ("sros2", None, "--keys DIR"),
        ("lan", "keys", "security is none"),
        ("tunnel", "out/keys", "copied to robots"),
        ("tunnel", "out", "copied to robots"),
    ):
        with pytest.raises(InputError, match=words):
            deploy(example(name), tmp_path / "out", None if keys is None else tmp_path / keys)
        assert list(tmp_path.iterdir()) == []


def test_a_bad_key_of_a_tunnel_is_named_with_the_remedy(own: Callable[[str], Path], tmp_path: Path) -> None:
    keys = own("tunnel").parent / "keys"
    key = keys / "floor" / "wireguard" / "cart-2.key"

    def refused(words: str) -> None:
        with pytest.raises(InputError, match=words):
            deploy(example("tunnel"), tmp_path / "again", keys)

    for content in ("", "not base64!", "c2hvcnQ="):
        key.write_text(content)
        refused(r"cart-2\.key does not contain a private key; restore it")
    key.chmod(0o644)
    refused(r"other accounts can read .*cart-2\.key, so it may be known; remove it")
    (keys / "floor").chmod(0o755)
    refused("chmod 700")
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
    expected = {"epoch_ns": 1767225600 * 10**9, "period_ns": 10_000_000, "agent_id": 2, "kind": "double_integrator"}
    assert given.items() >= {**expected, "damping": 1e-7}.items()
    assert given["lane_margin"] == pytest.approx(0.2)
    assert list(given["gains.kd"]) == [5.0, 5.0]
    drive = {name.removeprefix("drive."): value for name, value in given.items() if name.startswith("drive.")}
    assert (list(drive.pop("axes")), drive.pop("words")) == ([1.5, 2.0], ["1", "no"])
    assert drive == {"type": "rail.x", "port": "0", "speed": 3, "bus.rate": 1.5, "on": True}


def test_every_node_of_ros_reads_its_parameters(tmp_path: Path, ros: None) -> None:
    files = sorted(
        (deployed(load_fleet(edited(tmp_path / "f.yaml", ONE_HOST)), tmp_path / "out") / "base").rglob("nodes/*.yaml")
    )
    assert {file.stem for file in files} >= {
        "plane_sim",
        "abstraction_observer",
        "parent_controller",
        "recorder",
        "agent_001",
    }
    for file in files:
        context = rclpy.Context()
        rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context)
        node = rclpy.create_node(file.stem, context=context, automatically_declare_parameters_from_overrides=True)
        assert node.get_parameters_by_prefix("")
        node.destroy_node()
        rclpy.shutdown(context=context)
