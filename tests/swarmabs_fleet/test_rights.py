"""The rights of the enclaves against what the nodes use: enough for each, and none that it does not need."""

from __future__ import annotations

import fnmatch
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.swarmabs_fleet import endpoints_probe
from tests.swarmabs_fleet.bundle_processes import ended, running, write_below
from tests.swarmabs_fleet.fleets import ONE_HOST, deployed, edited

from swarmabs_config.fleet.loader import LoadedFleet, load_fleet
from swarmabs_config.fleet.participants import DISCOVERY, DISCOVERY_SERVER, NodePlan, node_plans
from swarmabs_fleet.host_plan import HostPlan
from swarmabs_fleet.operate import HealthMonitor, OperatorClient, Target
from swarmabs_fleet.parameters import parameter_file
from swarmabs_fleet.permissions import Rights, host_rights, node_rights
from swarmabs_run.orchestration.network import claimed_domain

DISCOVERY_INFO = "ros_discovery_info"
"""Used by each process for itself, so that it is no node's."""

Endpoints = dict[str, list[str]]


def fleet_of(plane: str, domain: int, folder: Path) -> LoadedFleet:
    """Return a fleet in a namespace with all kinds of nodes, but for a discovery server."""
    changes = [("domain: 7", f"domain: {domain}"), ("/etc/swarmabs", f"{folder}/etc")]
    changes.append(("scenario:", "namespace: /hall\nscenario:"))
    if plane != "simulated":
        changes.append((", recorder: {host: base}", ""))
        changes.append(("plane: {host", f"plane: {{type: driver, {plane}, host"))
        changes.append(("type: simulated, position: 0.1", "type: topic, topic: /odom, command_topic: cmd_vel"))
        changes.append(("type: simulated, position: -0.1", "type: topic, gravity: imu"))
    return load_fleet(edited(folder / "one.yaml", ONE_HOST, *changes))


def used_by_nodes(loaded: LoadedFleet, folder: Path) -> dict[str, Endpoints]:
    """Start all nodes of the fleet's one host, and a discovery server, and return their endpoints."""
    (folder / "etc").mkdir()
    bundle = (deployed(loaded, folder / "out") / "base").rename(folder / "etc" / "one")
    write_below(bundle, folder)
    add_server(bundle)
    names = [node.name for node in node_plans(loaded.fleet)] + [DISCOVERY]
    with running(bundle, folder) as units:
        for name, unit in units.items():
            assert unit.said(b"READY=1"), f"{name}: {unit.complaint()}"
        variables = dict(line.split("=", 1) for line in (bundle / "nodes/operator.env").read_text().splitlines())
        done = subprocess.run(
            [sys.executable, endpoints_probe.__file__, "60", *names],
            env={**os.environ, **variables, "ROS_LOG_DIR": str(folder / "ros")},
            capture_output=True,
            text=True,
            check=True,
        )
        assert set(ended(units)) == {0}
    found: dict[str, Endpoints] = json.loads(done.stdout)
    assert set(found) == set(names)
    return found


def add_server(bundle: Path) -> None:
    """Add the node of a discovery server, here with a profile by which it meets others like any coordinator."""
    nodes = bundle / "nodes"
    text = (nodes / "abstraction_observer.env").read_text()
    changed = text.replace("SWARMABS_PARTICIPANT=1\n", f"SWARMABS_PARTICIPANT={DISCOVERY_SERVER}\n")
    (nodes / f"{DISCOVERY}.env").write_text(changed)
    (nodes / f"{DISCOVERY}.yaml").write_text(parameter_file({}))
    unit = bundle / "systemd" / "swarmabs-one-abstraction_observer.service"
    text = unit.read_text().replace("abstraction_observer.realtime", "swarmabs_fleet.discovery_server")
    unit.with_name(f"swarmabs-one-{DISCOVERY}.service").write_text(text.replace("abstraction_observer", DISCOVERY))


def rights_of(loaded: LoadedFleet) -> dict[str, Rights]:
    server = NodePlan(DISCOVERY, "swarmabs_fleet.discovery_server", "base", DISCOVERY_SERVER, "server")
    return {node.name: node_rights(loaded.fleet, node) for node in (*node_plans(loaded.fleet), server)}


def differences(used: dict[str, Endpoints], rights: dict[str, Rights]) -> dict[str, list[str]]:
    """Return, by node, the endpoints without a right, and the rights without an endpoint."""
    found = {}
    for name, has in rights.items():
        for what, granted in (("publish", has.publish), ("subscribe", has.subscribe)):
            topics = {*used[name][what], DISCOVERY_INFO}
            lacking = [t for t in topics if not any(fnmatch.fnmatchcase(t, right) for right in granted)]
            idle = [right for right in granted if not any(fnmatch.fnmatchcase(t, right) for t in topics)]
            texts = [f"cannot {what} {t}" for t in lacking] + [f"may {what} {right} for nothing" for right in idle]
            found[name] = sorted(found.get(name, []) + texts)
    return {name: texts for name, texts in found.items() if texts}


@pytest.mark.system
@pytest.mark.timeout(150)
@pytest.mark.parametrize("plane", ["simulated", "topic: /encoder", pytest.param("source: imu", marks=pytest.mark.full)])
def test_every_node_may_do_what_it_does_and_no_more(plane: str, tmp_path: Path, nothing_survives: str) -> None:
    with claimed_domain() as domain:
        loaded = fleet_of(plane, domain, tmp_path)
        assert differences(used_by_nodes(loaded, tmp_path), rights_of(loaded)) == {}


class _AskedFor(Exception):  # noqa: N818 - it is no error
    """What a node was asked for."""


class Recording:
    """A node that makes nothing, but says by which topic of DDS it would."""

    def create_client(self, _: object, service: str) -> None:
        raise _AskedFor("publish", f"rq/hall/{service}Request", "subscribe", f"rr/hall/{service}Reply")

    def create_publisher(self, _: object, topic: str, *__: object) -> None:
        raise _AskedFor("publish", f"rt/hall/{topic}")

    def create_subscription(self, _: object, topic: str, *__: object) -> None:
        raise _AskedFor("subscribe", f"rt/hall/{topic}")


def test_the_operator_may_do_what_the_commands_do(tmp_path: Path) -> None:
    rights = host_rights(HostPlan(fleet_of("topic: /encoder", 7, tmp_path).fleet, "base"))["operator_base"]
    client = OperatorClient(Recording(), Target("one", "/hall", {}, (2,), {}))  # type: ignore[arg-type]
    actions: list[Callable[[], object]] = [
        lambda: client.announced(2, "gone", 1.0).__enter__(),
        lambda: client.listen(HealthMonitor({}), 1.0, lambda: False),
        *(lambda name=name: client.call(name, 1.0) for name in ("swarm/stop", "swarm/reset", "agent_001/leave")),  # type: ignore[misc]
    ]
    for action in actions:
        with pytest.raises(_AskedFor) as asked:
            action()
        words = asked.value.args
        for what, topic in zip(words[::2], words[1::2], strict=True):
            assert any(fnmatch.fnmatchcase(topic, right) for right in getattr(rights, what)), (what, topic)
    # As `ros2 service call` names its node.
    assert any(fnmatch.fnmatchcase("rr/_ros2cli_1/get_parametersReply", right) for right in rights.publish)
    assert not any(fnmatch.fnmatchcase("rt/hall/swarm/desired_abstract_state", right) for right in rights.publish)


def test_a_driver_has_the_other_side_of_what_its_node_has(tmp_path: Path) -> None:
    found = host_rights(HostPlan(fleet_of("source: imu", 7, tmp_path).fleet, "base"))
    driver = found["driver_base"]
    assert [topic for topic in driver.publish if "driver_base" not in topic][4:] == [
        "rt/hall/plane_driver/imu",
        "rt/odom",
        "rt/hall/agent_002/odom",
        "rt/hall/agent_002/imu",
    ]
    assert [topic for topic in driver.subscribe if "driver_base" not in topic][2:] == [
        "rt/hall/cmd_vel",
        "rt/hall/agent_002/force",
    ]
