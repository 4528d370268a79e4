"""Fast DDS with the profiles of bundles: who meets whom, and on which addresses anything listens."""

import ipaddress
import json
import os
import re
import signal
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from tests.processes import SEARCH_PATH, until
from tests.swarmabs_fleet.bundle_processes import installed, variables
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, edited, example

from swarmabs_config.fleet.loader import LoadedFleet, load_fleet
from swarmabs_config.fleet.participants import DISCOVERY, node_plans
from swarmabs_fleet import discovery_server
from swarmabs_fleet.bundle import host_bundle
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_run.orchestration.network import claimed_domain

NAMESPACE = {"d": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}


def xml(loaded: LoadedFleet, host: str, role: str) -> ET.Element:
    return ET.fromstring(host_bundle(loaded, HostPlan(loaded.fleet, host), None)[f"dds/{role}.xml"].content)


def lease(loaded: LoadedFleet) -> int:
    return int(xml(loaded, "base", "operator").findtext(".//d:leaseDuration/d:sec", "", NAMESPACE))


def unit(loaded: LoadedFleet, host: str) -> str:
    files = host_bundle(loaded, HostPlan(loaded.fleet, host), None)
    return next(file.content.decode() for path, file in files.items() if path.endswith(".service"))


def peers(root: ET.Element) -> set[tuple[str, int]]:
    locators = root.findall(".//d:initialPeersList/d:locator/d:udpv4", NAMESPACE)
    return {(one.findtext("d:address", "", NAMESPACE), int(one.findtext("d:port", "", NAMESPACE))) for one in locators}


def test_a_robot_knows_the_coordinators_and_they_know_all() -> None:
    lan = example("lan")
    coordinators = {("192.168.10.1", 7000 + 100 * 40 + 10 + 2 * participant) for participant in range(5)}
    robots = {(f"192.168.10.1{number}", 7000 + 100 * 40 + 10 + 2 * 8) for number in range(1, 5)}
    assert peers(xml(lan, "robot-2", "robot")) == coordinators
    assert peers(xml(lan, "base", "coordinator")) == coordinators | robots


def test_standbys_and_operators_beside_them_are_peers_as_their_primaries_are() -> None:
    pair = example("standby")
    plane = ("192.168.50.3", 7000 + 100 * 43 + 10)
    coordinators = {
        (f"192.168.50.{host}", plane[1] + 2 * participant) for host in (1, 2) for participant in range(1, 5)
    }
    robots = {(f"192.168.50.1{number}", plane[1] + 2 * 8) for number in range(1, 5)}
    assert peers(xml(pair, "robot-2", "robot")) >= coordinators | {plane}
    assert not peers(xml(pair, "robot-2", "robot")) & robots
    for host in ("base", "spare"):
        for role in ("coordinator", "operator"):
            assert peers(xml(pair, host, role)) == coordinators | robots | {plane}


def test_only_with_security_a_participant_may_be_silent_for_longer_than_a_start_takes() -> None:
    """Two of which one has forgotten the other never authenticate again."""
    timeout = re.search(r"^TimeoutStartSec=(\d+)$", unit(example("sros2"), "base"), re.MULTILINE)
    assert timeout is not None
    leases = {name: lease(example(name)) for name in EXAMPLES}
    assert leases.pop("sros2") > int(timeout[1])
    assert set(leases.values()) == {5}


@pytest.mark.parametrize("name", EXAMPLES)
def test_every_profile_is_bound_to_the_one_address_of_its_host(name: str) -> None:
    loaded = example(name)
    for host in loaded.fleet.hosts:
        address = host.tunnel_address or host.address
        for path, file in host_bundle(loaded, HostPlan(loaded.fleet, host.name), None).items():
            if path.startswith("dds/"):
                root = ET.fromstring(file.content)
                listed = [element.text for element in root.findall(".//d:interfaceWhiteList/*", NAMESPACE)]
                assert listed == [address]
                assert root.findtext(".//d:useBuiltinTransports", "", NAMESPACE) == "false"
                assert root.findtext(".//d:use_WriterLivelinessProtocol", "", NAMESPACE) == "true"
                own = root.findall(".//d:builtin/d:metatrafficUnicastLocatorList//d:address", NAMESPACE)
                assert {element.text for element in own} <= {address}


@pytest.mark.parametrize(
    ("network", "robot", "base"),
    [
        ("static", "192.168.10.12 192.168.10.1", [".1", ".11", ".12", ".13", ".14"]),
        ("multicast", "192.168.10.12 192.168.10.1 239.255.0.1", [".1", ".11", ".12", ".13", ".14", "239.255.0.1"]),
        ("server, server: robot-4", "192.168.10.12 192.168.10.1 192.168.10.14", [".1", ".11", ".12", ".13", ".14"]),
    ],
)
def test_nodes_may_talk_to_those_they_meet_only(network: str, robot: str, base: list[str], tmp_path: Path) -> None:
    text = EXAMPLES["lan"].read_text(encoding="utf-8")
    loaded = load_fleet(edited(tmp_path / "lan.yaml", text, ("discovery: static", f"discovery: {network}")))
    files = host_bundle(loaded, HostPlan(loaded.fleet, "robot-2"), None)
    assert f"IPAddressAllow=localhost {robot}\n" in files["systemd/swarmabs-lan-agent_002.service"].content.decode()
    files = host_bundle(loaded, HostPlan(loaded.fleet, "base"), None)
    allowed = " ".join(f"192.168.10{address}" if address[0] == "." else address for address in base)
    controller = files["systemd/swarmabs-lan-parent_controller.service"].content.decode()
    assert f"IPAddressAllow=localhost {allowed}\n" in controller
    servers = [node.host for node in node_plans(loaded.fleet) if node.name == DISCOVERY]
    assert servers == (["robot-4"] if network.startswith("server") else [])
    for host in servers:
        bundle = host_bundle(loaded, HostPlan(loaded.fleet, host), None)
        server = bundle["systemd/swarmabs-lan-discovery_server.service"].content.decode()
        assert "WatchdogSec=10\n" in server, "no robot waits for it"
    operator = files["nodes/operator.env"].content.decode().splitlines()
    assert {"ROS_DOMAIN_ID=40", "SWARMABS_PARTICIPANT=4"} <= set(operator)
    profile = files["dds/operator.xml"].content.decode()
    assert ("CLIENT" in profile) == network.startswith("server")


def test_a_discovery_server_that_is_told_to_end_while_it_waits_serves_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[object] = []
    monkeypatch.setattr(discovery_server, "initialise", pytest.fail)
    monkeypatch.setattr(signal, "pthread_sigmask", lambda *how: waited.append(how))
    monkeypatch.setattr(signal, "sigtimedwait", lambda *what: waited.append(what) or signal.SIGTERM)
    assert discovery_server.main([]) == 0
    ends = (signal.SIGINT, signal.SIGTERM)
    assert waited == [(signal.SIG_BLOCK, ends), (ends, discovery_server.FORGOTTEN_AFTER)]


@pytest.mark.system
@pytest.mark.parametrize("discovery", ["static", "multicast", "server, server: base"])
def test_nodes_meet_with_each_discovery_on_one_address_only(
    discovery: str, tmp_path: Path, nothing_survives: str
) -> None:
    with claimed_domain() as domain, ExitStack() as stack:
        text = ONE_HOST.replace("discovery: static", f"discovery: {discovery}")
        changes = (("domain: 7", f"domain: {domain}"), ("/etc/swarmabs", f"{tmp_path}/etc"))
        bundle = installed(load_fleet(edited(tmp_path / "one.yaml", text, *changes)), tmp_path)

        def start(name: str, *command: str) -> None:
            words = command or (sys.executable, "-m", "tests.swarmabs_fleet.talker", name)
            own = {"PYTHONSAFEPATH": "", "ROS_LOG_DIR": str(bundle / "logs")}
            environment = {**os.environ, **SEARCH_PATH, **variables(bundle / "nodes" / f"{name}.env"), **own}
            file = stack.enter_context((bundle / f"{name}.txt").open("wb"))
            process = subprocess.Popen(words, env=environment, stdout=file)
            stack.callback(process.wait)
            stack.callback(process.kill)

        def seen(name: str) -> list[list[str]]:
            """Return what a talker heard last: names of talkers, of nodes, own addresses, own ports."""
            lines = (bundle / f"{name}.txt").read_text().splitlines()
            last: list[list[str]] = json.loads(lines[-1]) if lines else [[], [], [], []]
            return last

        if "server" in discovery:
            start("discovery_server", sys.executable, "-m", "swarmabs_fleet.discovery_server")
        start("agent_001")
        start("agent_002")
        # The coordinator comes later than those who need it, as after a restart.
        until(lambda: seen("agent_001")[0], "the first robot hears itself", 30.0)
        start("parent_controller")
        start("operator")
        both = {"parent_controller", "operator"}
        for name in ("agent_001", "agent_002"):
            until(lambda name=name: both < set(seen(name)[0]), f"{name} hears the coordinators", 30.0)  # type: ignore[misc]
        everybody = both | {"agent_001", "agent_002"}
        until(lambda: set(seen("parent_controller")[0]) == everybody, "the coordinator hears all", 30.0)
        for name in everybody:
            addresses = [ipaddress.ip_address(text) for text in seen(name)[2]]
            assert {str(one) for one in addresses if not one.is_multicast} == {"127.0.0.1"}
            assert any(one.is_multicast for one in addresses) == (discovery == "multicast")
        participant = {"parent_controller": 2, "operator": 4, "agent_001": 8, "agent_002": 9}
        for name, number in participant.items():
            first = 7000 + 100 * domain + 10 + 2 * number
            assert {first, first + 1} <= set(seen(name)[3])  # type: ignore[comparison-overlap]
        if discovery == "static":
            assert "agent_002" not in seen("agent_001")[1], "robots discover each other"
