"""Bundles of a fleet without observer and controller: whom each robot meets, what it may do, what its node is told."""

import time
from contextlib import nullcontext
from pathlib import Path

import pytest
from tests.swarmabs_fleet.fleets import EXAMPLES, edited, example, uses_keys
from tests.swarmabs_fleet.test_profile import peers, xml
from tests.swarmabs_fleet.test_security import wireguard

from agent_node.realtime_peer import PARAMETERS
from swarmabs_cli import main
from swarmabs_cli.fleet import operate
from swarmabs_config.fleet.loader import LoadedFleet, load_fleet
from swarmabs_config.fleet.participants import node_plans, operator_hosts
from swarmabs_config.graph import CONTROLLER, OBSERVER, PEER, PLANE, RECORDER
from swarmabs_config.seals import EcdsaSeals, opened
from swarmabs_core.errors import InputError
from swarmabs_core.hearing import Hearing
from swarmabs_core.messages import PARENT
from swarmabs_core.realtime.seals import SealFiles
from swarmabs_fleet.bundle import deploy
from swarmabs_fleet.operate import HealthMonitor
from swarmabs_fleet.parameters import parameters
from swarmabs_fleet.permissions import node_rights
from swarmabs_ros.parameters import table_of
from swarmabs_ros.realtime_runner import COMMON

TEXT = EXAMPLES["no_observer"].read_text(encoding="utf-8")
FIRST_PORT = 7000 + 100 * 46 + 10


def test_every_robot_meets_all_others_and_an_operator_is_on_the_base() -> None:
    fleet = example("no_observer")
    assert not uses_keys("no_observer")
    assert not {OBSERVER, CONTROLLER} & {node.name for node in node_plans(fleet.fleet)}
    assert operator_hosts(fleet.fleet) == ("base",)
    base = {("192.168.10.1", FIRST_PORT + 2 * participant) for participant in (0, 3, 4)}
    robots = {(f"192.168.10.1{number}", FIRST_PORT + 2 * 8) for number in range(1, 5)}
    assert peers(xml(fleet, "robot-2", "robot")) == base | robots


def test_a_robots_node_gets_all_that_it_declares() -> None:
    fleet = example("no_observer")
    (node,) = (node for node in node_plans(fleet.fleet) if node.robot and node.robot.id == 2)
    given = parameters(fleet, node)
    assert node.kind == PEER
    assert (given["neighbours"], given["start_mode"], given["agent_id"]) == ((1, 3, 4), "stop", 2)
    assert {parameter.name for parameter in table_of(given, (), PARAMETERS)} >= given.keys() - {
        parameter.name for parameter in COMMON
    }


def test_a_robot_may_publish_its_own_relay_and_read_all_and_offers_no_service_of_a_controller() -> None:
    fleet = example("no_observer")
    (node,) = (node for node in node_plans(fleet.fleet) if node.robot and node.robot.id == 2)
    rights = node_rights(fleet.fleet, node)
    assert "rt/agent_002/*" in rights.publish
    assert not any("agent_001" in topic or topic == "rt/plane/state" for topic in rights.publish)
    assert {"rt/agent_*/relay", "rt/plane/state", "rt/swarm/removals"} <= set(rights.subscribe)
    assert not any("swarm/stop" in topic for topic in rights.subscribe)


def test_status_tells_whom_each_robot_hears(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    hearing = Hearing((1, 3), 3, {1: 2, 2: 0, 3: 3}, (4,), majority=True).values()

    class Client:
        """Hears two nodes."""

        def listen(self, monitor: HealthMonitor, *_: object) -> None:
            monitor.hear("plane_sim", 0, "moves", {}, time.monotonic())
            monitor.hear("agent_002", 0, "follows", dict(hearing), time.monotonic())
            monitor.hear("agent_003", 0, "follows", dict(hearing) | {"neighbours": "some"}, time.monotonic())
            monitor.hear("agent_004", 0, "follows", dict(hearing), time.monotonic() - 100.0)

    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(operate, "joined", lambda _: nullcontext(Client()))
    assert main(["status", str(EXAMPLES["no_observer"])]) == 1
    printed = capsys.readouterr().out
    rows = {line.split()[0]: " ".join(line.split()) for line in printed.splitlines()}
    assert rows["node"] == "node host health links message"
    assert rows["plane_sim"] == "plane_sim base OK moves"
    assert rows["agent_002"] == "agent_002 robot-2 OK hears 2 of 3, oldest 3 steps, lacks 4 follows"
    assert rows["agent_003"] == "agent_003 robot-3 OK follows"
    assert rows["agent_004"].startswith("agent_004 robot-4 silent no diagnostics for 100 s")


def test_a_tunnel_joins_all_hosts(tmp_path: Path) -> None:
    text = EXAMPLES["tunnel"].read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.strip().startswith(("observer:", "controller:"))]
    path = edited(tmp_path / "floor.yaml", "\n".join(kept), ("\nset: {", "\nset: {coordination: each_robot, "))
    deploy(load_fleet(path), tmp_path / "out", tmp_path / "keys")
    files = {file.parts[-3]: wireguard(file)[1] for file in (tmp_path / "out").glob("*/wireguard/*.conf")}
    assert len(files) == 4
    assert all(len(others) == 3 for others in files.values())


def sealed_fleet(folder: Path) -> LoadedFleet:
    secure = "security: {level: sros2}\ninstallation: {ros: sourced}"
    path = edited(folder / "sealed.yaml", TEXT, ("security: {level: none}", secure), ("no_observer\n", "hall\n"))
    return load_fleet(path)


def seals_in(fleet: LoadedFleet, bundles: Path, author: int) -> EcdsaSeals:
    """Return the keys with which the node of an author starts, from the files of its bundle."""
    (node,) = (node for node in node_plans(fleet.fleet) if node.author == author)
    given = parameters(fleet, node)
    key, keys = (
        str(bundles / node.host / Path(str(given[name])).relative_to("/etc/swarmabs/hall"))
        for name in ("seal.key", "seal.keys")
    )
    return opened(SealFiles(key, keys), author)


def test_with_certificates_robots_and_plane_sign_their_states_with_the_keys_of_these(tmp_path: Path) -> None:
    fleet = sealed_fleet(tmp_path)
    deploy(fleet, tmp_path / "out", tmp_path / "keys")
    authors = (PARENT, 1, 2, 3, 4)
    seals = {author: seals_in(fleet, tmp_path / "out", author) for author in authors}
    for author in authors:
        signature = seals[author].sign(b"state")
        for one in seals.values():
            assert [who for who in authors if one.holds(who, b"state", signature)] == [author]
    others = [node for node in node_plans(fleet.fleet) if node.author is None]
    assert [node.kind for node in others] == [RECORDER]
    assert not any("seal.key" in parameters(fleet, node) for node in others)
    assert not any("seal.key" in parameters(example("no_observer"), node) for node in node_plans(fleet.fleet))


def test_a_revoked_key_no_longer_signs(tmp_path: Path) -> None:
    fleet = sealed_fleet(tmp_path)
    deploy(fleet, tmp_path / "out", tmp_path / "keys")
    signature = seals_in(fleet, tmp_path / "out", 2).sign(b"state")
    deploy(fleet, tmp_path / "later", tmp_path / "keys", ["robot-2"])
    assert not seals_in(fleet, tmp_path / "later", 3).holds(2, b"state", signature)
    renewed = seals_in(fleet, tmp_path / "later", 2).sign(b"state")
    assert all(seals_in(fleet, tmp_path / "later", author).holds(2, b"state", renewed) for author in (PARENT, 1, 4))


def test_only_the_plane_may_publish_its_signed_states_and_robots_may_read_them(tmp_path: Path) -> None:
    fleet = sealed_fleet(tmp_path)
    rights = {node.name: node_rights(fleet.fleet, node) for node in node_plans(fleet.fleet)}
    assert [name for name, right in rights.items() if "rt/plane/relay" in right.publish] == [PLANE]
    assert [name for name, right in rights.items() if "rt/plane/relay" in right.subscribe] == [
        f"agent_00{robot}" for robot in (1, 2, 3, 4)
    ]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("plane: {host: base}", "plane: {host: base}\n  observer: {host: base}", "coordinators.observer"),
        ("plane: {host: base}", "plane: {host: base}\n  controller: {host: base}", "coordinators.controller"),
        ("set: {coordination: each_robot}\n", "", "there is no observer; add 'observer: {host: HOST}', or"),
    ],
)
def test_coordinators_and_coordination_must_agree(old: str, new: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words.replace("{", r"\{").replace("}", r"\}")):
        load_fleet(edited(tmp_path / "bad.yaml", TEXT, (old, new)))
