"""Fast DDS with the profiles of bundles: who meets whom, and on which addresses anything listens."""

from __future__ import annotations

import ipaddress
import json
import os
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from tests.processes import until
from tests.swarmabs_fleet.fleets import EXAMPLES, ONE_HOST, deployed, edited, example

from swarmabs_config.fleet.loader import LoadedFleet, load_fleet
from swarmabs_fleet.bundle import host_bundle
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_run.orchestration.network import claimed_domain

NAMESPACE = {"d": "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"}

TALKER = """
import json, sys, time
import psutil, rclpy
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node(sys.argv[1])
publisher = node.create_publisher(String, "/talk", 10)
heard = set()
node.create_subscription(String, "/talk", lambda message: heard.add(message.data), 10)
told = None
while True:
    publisher.publish(String(data=sys.argv[1]))
    rclpy.spin_once(node, timeout_sec=0.05)
    sockets = {c.laddr.ip for c in psutil.Process().net_connections("udp") if c.laddr}
    ports = {c.laddr.port for c in psutil.Process().net_connections("udp") if c.laddr}
    seen = [sorted(heard), sorted(set(node.get_node_names())), sorted(sockets), sorted(ports)]
    if seen != told:
        print(json.dumps(seen), flush=True)
        told = seen
"""


def xml(loaded: LoadedFleet, host: str, role: str) -> ET.Element:
    return ET.fromstring(host_bundle(loaded, HostPlan(loaded.fleet, host), None)[f"dds/{role}.xml"].content)


def peers(root: ET.Element) -> set[tuple[str, int]]:
    found = root.findall(".//d:initialPeersList/d:locator/d:udpv4", NAMESPACE)
    return {(one.findtext("d:address", "", NAMESPACE), int(one.findtext("d:port", "", NAMESPACE))) for one in found}


def test_a_robot_knows_the_coordinators_and_they_know_all() -> None:
    lan = example("lan")
    coordinators = {("192.168.10.1", 7000 + 100 * 40 + 10 + 2 * participant) for participant in range(5)}
    robots = {(f"192.168.10.1{number}", 7000 + 100 * 40 + 10 + 2 * 8) for number in range(1, 5)}
    assert peers(xml(lan, "robot-2", "robot")) == coordinators
    assert peers(xml(lan, "base", "coordinator")) == coordinators | robots


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


class Talkers:
    """Processes with the environments of a bundle."""

    def __init__(self, bundle: Path, stack: ExitStack) -> None:
        self._bundle = bundle
        self._stack = stack
        self._seen: dict[str, Path] = {}

    def environment(self, name: str) -> dict[str, str]:
        lines = (self._bundle / "nodes" / f"{name}.env").read_text().splitlines()
        own = {"PYTHONSAFEPATH": "", "ROS_LOG_DIR": str(self._bundle / "logs")}
        return dict(os.environ) | dict(line.split("=", 1) for line in lines) | own

    def start(self, name: str, *command: str) -> None:
        out = self._bundle / f"{name}.txt"
        file = self._stack.enter_context(out.open("wb"))
        words = command or (sys.executable, "-c", TALKER, name)
        process = subprocess.Popen(words, env=self.environment(name), stdout=file)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        self._seen[name] = out

    def seen(self, name: str) -> list[list[str]]:
        """Return what a talker heard last: names of talkers, of nodes, own addresses, own ports."""
        lines = self._seen[name].read_text().splitlines()
        last: list[list[str]] = json.loads(lines[-1]) if lines else [[], [], [], []]
        return last


@pytest.mark.system
@pytest.mark.timeout(60)
@pytest.mark.parametrize("discovery", ["static", "multicast", "server, server: base"])
def test_nodes_meet_with_each_discovery_on_one_address_only(
    discovery: str, tmp_path: Path, nothing_survives: str
) -> None:
    with claimed_domain() as domain, ExitStack() as stack:
        prefix = tmp_path / "etc"
        text = ONE_HOST.replace("discovery: static", f"discovery: {discovery}")
        changes = (("domain: 7", f"domain: {domain}"), ("/etc/swarmabs", str(prefix)))
        output = deployed(load_fleet(edited(tmp_path / "one.yaml", text, *changes)), tmp_path / "out")
        prefix.mkdir()
        bundle = (output / "base").rename(prefix / "one")
        talkers = Talkers(bundle, stack)
        if "server" in discovery:
            talkers.start("discovery_server", sys.executable, "-m", "swarmabs_fleet.discovery_server")
        talkers.start("agent_001")
        talkers.start("agent_002")
        # The coordinator comes later than those who need it, as after a restart.
        until(lambda: talkers.seen("agent_001")[0], "the first robot hears itself", 30.0)
        talkers.start("parent_controller")
        talkers.start("operator")
        both = {"parent_controller", "operator"}
        for name in ("agent_001", "agent_002"):
            until(lambda name=name: both < set(talkers.seen(name)[0]), f"{name} hears the coordinators", 30.0)  # type: ignore[misc]
        everybody = both | {"agent_001", "agent_002"}
        until(lambda: set(talkers.seen("parent_controller")[0]) == everybody, "the coordinator hears all", 30.0)
        for name in everybody:
            addresses = [ipaddress.ip_address(text) for text in talkers.seen(name)[2]]
            assert {str(one) for one in addresses if not one.is_multicast} == {"127.0.0.1"}
            assert any(one.is_multicast for one in addresses) == (discovery == "multicast")
        participant = {"parent_controller": 2, "operator": 4, "agent_001": 8, "agent_002": 9}
        for name, number in participant.items():
            first = 7000 + 100 * domain + 10 + 2 * number
            assert {first, first + 1} <= set(talkers.seen(name)[3])  # type: ignore[comparison-overlap]
        if discovery == "static":
            assert "agent_002" not in talkers.seen("agent_001")[1], "robots discover each other"
