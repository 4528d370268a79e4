"""DDS between hosts: with static peers and by multicast, on one address and nowhere else.

Each host is also in a second network, which is not trusted. What listens is read from the kernel; what is sent is
counted by the switches.
"""

import json
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.hosts.cluster import Host, hosts

from swarmabs_config.ports import metatraffic_port
from swarmabs_fleet.node_files import DISCOVERY_GROUP
from swarmabs_run.orchestration.network import FIRST_FREE, Discovery, dds_environment, network_profile_xml

pytestmark = [pytest.mark.system, pytest.mark.timeout(300), pytest.mark.usefixtures("possible")]

DOMAIN = 7


def talker(host: Host, folder: Path, profile: str) -> subprocess.Popen[Any]:
    path = folder / f"{host.name}.xml"
    path.write_text(profile, encoding="utf-8")
    environment = {**dds_environment(DOMAIN, str(path)), "ROS_LOG_DIR": str(folder)}
    return host.python("tests.swarmabs_fleet.talker", host.name, env=environment, stdout=subprocess.PIPE)


def said(process: subprocess.Popen[Any]) -> tuple[list[list[Any]], str]:
    """Return what a node says next, and what Fast DDS has printed before."""
    assert process.stdout is not None
    before = ""
    for line in process.stdout:
        if line.startswith("["):
            return json.loads(line), before
        before += line
    raise AssertionError(f"it has ended: {before}")


@contextmanager
def talking(pair: Sequence[Host], folder: Path, profile: Callable[[Host], str]) -> Iterator[None]:
    """Let two hosts hear each other during the block."""
    processes = [talker(host, folder, profile(host)) for host in pair]
    for process in processes:
        while len(said(process)[0][0]) < len(pair):
            pass
    yield
    for process in processes:
        with process:
            process.kill()


@pytest.mark.parametrize("peers", ["static", "multicast"])
def test_hosts_talk_on_one_address_and_nothing_listens_elsewhere(peers: str, tmp_path: Path) -> None:
    with hosts(2, networks=2) as pair:
        static = peers == "static"
        known = tuple((host.address, metatraffic_port(DOMAIN, 0)) for host in pair) if static else None
        groups = set() if static else {DISCOVERY_GROUP}
        peers_of = Discovery(peers=known)
        with talking(pair, tmp_path, lambda host: network_profile_xml(host.address, peers_of, FIRST_FREE)):
            for host in pair:
                assert host.listening() == {("udp", address) for address in {host.address} | groups}
                assert host.groups() == ({"eth0": groups} if groups else {})
        trusted, untrusted = pair.switches
        assert (trusted.dds_messages() > 20, untrusted.dds_messages()) == (True, 0)


def test_without_a_profile_that_can_be_read_everything_is_open(tmp_path: Path) -> None:
    """Fast DDS notes the error and goes on with its defaults. It also shows that the test above can fail."""
    with hosts(2, networks=2) as pair:
        with talking(pair, tmp_path, lambda _: "<dds><profiles><participant/></profiles></dds>"):
            for host in pair:
                assert ("udp", "0.0.0.0") in host.listening()
                assert set(host.groups()) == {"lo", "eth0", "eth1"}
        assert pair.switches[1].dds_messages() > 0


def test_without_its_address_a_node_is_deaf_and_goes_on(tmp_path: Path) -> None:
    """That is safe, but nobody is told: what starts a node has to wait for the interface."""
    with hosts(1) as (host,):
        node = talker(host, tmp_path, network_profile_xml("10.84.0.1", Discovery(), FIRST_FREE))
        (_, _, *places), printed = said(node)
        assert "All whitelist interfaces were filtered out" in printed
        assert places == [[], []] and host.listening() == set()
