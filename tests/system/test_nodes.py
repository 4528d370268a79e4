"""Nodes in real time: lifecycle, diagnostics and services over DDS, and a node that stands still."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.processes import until
from tests.system.realtime import PATIENCE, Client, Network, realtime_network, start_swarm

from swarmabs_core.messages import NEVER, EventKind, Status

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]

WARN, ERROR = 1, 2
AGENT = "swarm/agent_state"


@pytest.fixture
def network(tmp_path: Path) -> Iterator[Network]:
    with realtime_network(tmp_path) as network:
        yield network


def state_of(client: Client, agent_id: int) -> dict[str, Any]:
    newest: dict[str, Any] = client.look()["newest"].get(f"{AGENT} {agent_id}", {})
    return newest


def follows(client: Client, agent_id: int) -> bool:
    state = state_of(client, agent_id)
    return state.get("status") == Status.ACTIVE and state["broadcast_step"] != NEVER


def until_silent(client: Client, node: str, key: str) -> None:
    """Wait until, between two diagnostics of a node that is not active, nothing more of it is heard."""

    def silent() -> bool:
        before = client.look()
        until(lambda: client.health(node)["count"] > before["diagnostics"][node]["count"], "new diagnostics", PATIENCE)
        return bool(client.look()["heard"].get(key) == before["heard"].get(key))

    until(silent, f"{key} falls silent", PATIENCE)


def test_the_lifecycle_of_a_robot(network: Network) -> None:
    client = network.client()
    robot = network.start("agent_node.realtime", "agent_001", autostart="false", agent_id=1, mass=0.3)
    key = f"{AGENT} 1"
    assert client.state("agent_001") == "unconfigured"
    client.until_healthy("agent_001", level=WARN)
    assert client.change("agent_001", "activate") is False, "there is nothing to activate"
    assert client.change("agent_001", "configure") is True
    assert client.state("agent_001") == "inactive"
    until(lambda: client.health("agent_001")["values"]["state"] == "inactive", "diagnostics follow", PATIENCE)
    assert key not in client.look()["heard"], "an inactive robot is silent"
    assert client.trigger("agent_001/leave")[0] is False

    assert client.set_parameter("agent_001", "gains.k", [12.0, 11.0]) == ""
    assert client.change("agent_001", "activate") is True
    until(lambda: client.look()["heard"].get(key, 0) > 20, "the robot's states are heard", PATIENCE)
    assert client.parameter("agent_001", "gains.k") == [12.0, 11.0]
    assert "agent_001 is active" in client.set_parameter("agent_001", "gains.ksd", 3.0)
    assert "no ROS clock" in client.set_parameter("agent_001", "use_sim_time", True)
    for line in ("gains.k set to [12.0, 11.0]", "active"):
        until(lambda line=line: ["agent_001", line] in client.look()["logged"], f"{line!r} in /rosout", PATIENCE)
    until(lambda: client.health("agent_001")["values"]["state"] == "active", "diagnostics follow", PATIENCE)
    health = client.health("agent_001")
    assert (health["name"], health["level"]) == ("agent_001: realtime", ERROR)
    assert health["message"].startswith("safe stop: ")
    assert int(health["values"]["steps made"]) > 20
    assert state_of(client, 1)["status"] == Status.SAFE_STOP

    assert client.change("agent_001", "deactivate") is True
    until_silent(client, "agent_001", key)
    assert client.change("agent_001", "cleanup") is True
    assert client.state("agent_001") == "unconfigured"
    assert client.change("agent_001", "configure") is True
    heard = client.look()["heard"][key]
    assert client.change("agent_001", "activate") is True
    until(lambda: client.look()["heard"][key] > heard + 20, "its states are heard again", PATIENCE)
    assert client.look()["repeated"] == 0, "no step comes twice"

    assert client.change("agent_001", "shutdown") is True
    assert client.state("agent_001") == "finalized"
    assert robot.terminate() == 0, robot.log()
    assert "Traceback" not in robot.log()
    timings = [report for report in network.read_reports() if report["event"] == "timing"]
    assert len(timings) == 2, "one each time it was taken back"
    for timing in timings:
        assert sum(timing["lateness_us"].values()) == timing["steps"] > 20


def test_a_node_that_stands_still_does_not_stop_the_others_and_comes_back(network: Network) -> None:
    client = network.client()
    nodes = start_swarm(network)
    client.until_healthy(*nodes)
    until(lambda: all(follows(client, i) for i in (1, 2, 3)), "three robots follow", PATIENCE)
    silent = client.look()["fallen_silent"].get(AGENT, 0)

    os.kill(nodes["agent_002"].pid, signal.SIGSTOP)
    until(lambda: client.look()["fallen_silent"][AGENT] > silent, "the middleware notices", PATIENCE)
    until(lambda: [2, EventKind.DEAD, "silent"] in client.look()["events"], "the observer says so", PATIENCE)
    steps = {i: state_of(client, i)["step"] for i in (1, 2, 3)}

    def goes_on(*robots: int) -> bool:
        return all(follows(client, i) and state_of(client, i)["step"] > steps[i] + 100 for i in robots)

    until(lambda: goes_on(1, 3), "the others go on", PATIENCE)
    assert state_of(client, 2)["step"] == steps[2]
    until(lambda: "agent_002" not in client.nodes(), "the middleware forgets the node", PATIENCE)

    alive = client.look()["come_alive"][AGENT]
    os.kill(nodes["agent_002"].pid, signal.SIGCONT)
    until(lambda: goes_on(2), lambda: f"it comes back: {client.health('agent_002')}, {state_of(client, 2)}", PATIENCE)
    until(lambda: client.look()["come_alive"][AGENT] > alive, "the middleware notices", PATIENCE)
    client.until_healthy(*nodes)
    # Diagnostics come once a second.
    until(lambda: int(client.health("agent_002")["values"]["periods missed"]) > 0, "it says so", PATIENCE)
    assert client.look()["repeated"] == 0
