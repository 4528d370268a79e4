"""Nodes in real time as processes: lifecycle, diagnostics, an operator's services, a node that stands still."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.processes import until
from tests.system.realtime import PATIENCE, Client, Network, realtime_network, start_swarm

from swarmabs_core.messages import NEVER, EventKind, Mode, Status

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]

BROADCASTS = ["/swarm/abstract_state", "/swarm/auxiliary_state", "/swarm/desired_abstract_state"]
WARN, ERROR = 1, 2
AGENT = "swarm/agent_state"


@pytest.fixture
def network(tmp_path: Path) -> Iterator[Network]:
    with realtime_network(tmp_path) as network:
        yield network


def state_of(client: Client, agent_id: int) -> dict[str, Any]:
    found: dict[str, Any] = client.look()["newest"].get(f"{AGENT} {agent_id}", {})
    return found


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
    assert client.change_by_id("agent_001", 99) is False, "and no such transition"
    assert client.change("agent_001", "configure") is True
    assert client.state("agent_001") == "inactive"
    until(lambda: client.health("agent_001")["values"]["state"] == "inactive", "diagnostics follow", PATIENCE)
    assert key not in client.look()["heard"], "an inactive robot is silent"
    assert client.trigger("agent_001/leave")[0] is False

    assert client.change("agent_001", "activate") is True
    until(lambda: client.look()["heard"].get(key, 0) > 20, "the robot's states are heard", PATIENCE)
    until(lambda: client.health("agent_001")["values"]["state"] == "active", "diagnostics follow", PATIENCE)
    health = client.health("agent_001")
    assert health["name"] == "agent_001: realtime"
    assert health["message"].startswith("safe stop: ")
    assert health["level"] == ERROR
    assert int(health["values"]["steps made"]) > 20
    assert state_of(client, 1)["status"] == Status.SAFE_STOP
    assert client.parameter("agent_001", "mass") == [0.3, "mass, kg", True]
    assert client.set_parameter("agent_001", "mass", 0.4) is False

    for _ in range(2):
        assert client.change("agent_001", "deactivate") is True
        until_silent(client, "agent_001", key)
        assert client.change("agent_001", "cleanup") is True
        assert client.state("agent_001") == "unconfigured"
        assert client.change("agent_001", "configure") is True
        heard = client.look()["heard"][key]
        assert client.change("agent_001", "activate") is True
        until(lambda heard=heard: client.look()["heard"][key] > heard + 20, "its states are heard again", PATIENCE)  # type: ignore[misc]
    assert client.look()["repeated"] == 0, "no step comes twice"

    assert client.change("agent_001", "shutdown") is True
    assert client.state("agent_001") == "finalized"
    assert robot.terminate() == 0, robot.log()
    assert "Traceback" not in robot.log()
    timings = [report for report in network.read_reports() if report["event"] == "timing"]
    assert len(timings) == 3, "one each time it was taken back"
    for timing in timings:
        assert sum(timing["lateness_us"].values()) == timing["steps"] > 20


def test_an_error_halts_the_node_is_named_and_is_no_end(network: Network, tmp_path: Path) -> None:
    client = network.client()
    cable = tmp_path / "cable_off"
    node = network.start("tests.system.failing_node", "failing", file=cable)
    client.until_healthy("failing")
    cable.touch()
    client.until_healthy("failing", level=ERROR)
    assert client.health("failing")["message"].endswith("after an error: OSError: the cable is off")
    until(lambda: client.state("failing") == "unconfigured", "the node has left the active state", PATIENCE)
    assert cable.with_suffix(".halted").exists()
    until_silent(client, "failing", "plane/state")
    assert {"node": "failing", "event": "failed", "pid": node.pid, "reason": "OSError: the cable is off"} in (
        network.read_reports()
    )
    cable.unlink()
    assert client.change("failing", "configure") is True
    assert client.change("failing", "activate") is True
    client.until_healthy("failing")

    until(lambda: client.garbage() == 1, "the client's garbage meets the node", PATIENCE)
    until(lambda: int(client.health("failing")["values"]["malformed messages"]) > 0, "it is refused", PATIENCE)
    assert "frame_id is not 'plane'" in client.health("failing")["values"]["last malformed"]
    assert client.is_healthy("failing")
    assert node.terminate() == 0, node.log()


@pytest.mark.parametrize("way", ["deactivate", "shutdown", "SIGTERM", "failure"])
def test_a_node_whose_body_does_not_stop_says_so_and_ends(network: Network, tmp_path: Path, way: str) -> None:
    client = network.client()
    cable = tmp_path / "cable_off"
    node = network.start("tests.system.failing_node", "failing", file=cable)
    client.until_healthy("failing")
    cable.with_suffix(".hangs").touch()
    if way == "SIGTERM":
        os.kill(node.pid, signal.SIGTERM)
    elif way == "failure":
        cable.touch()
    else:
        assert client.change("failing", way) is False
    assert node.wait() == 1, node.log()
    said = "halting has not ended within 5 s: a drive's stop() hangs, or a step before it; this process ends"
    assert said in node.log()
    assert "Traceback" not in node.log()
    health = client.health("failing")
    assert health["level"] == ERROR
    assert said in health["message"]
    assert any(said in report["reason"] for report in network.read_reports() if report["event"] == "failed")


def test_a_swarm_follows_stops_and_goes_on_when_told(network: Network) -> None:
    client = network.client()
    nodes = start_swarm(network)
    client.until_healthy(*nodes)
    assert all(follows(client, agent_id) for agent_id in (1, 2, 3))

    for agent_id in (1, 2, 3):
        graph = client.graph(f"agent_{agent_id:03d}")
        assert graph["hears"] == BROADCASTS
        own = [name for name in graph["publishes"] if not name.startswith(f"/agent_{agent_id:03d}/")]
        assert own == ["/diagnostics", "/parameter_events", "/rosout", "/swarm/agent_state", "/swarm/events"]
    assert {"/swarm/stop", "/swarm/reset"} <= set(client.graph("parent_controller")["serves"])

    assert client.trigger("swarm/stop") == [True, ""]
    # The answer came after the message was published.
    until(lambda: client.look()["modes"][-1] == Mode.STOP, "STOP is heard", PATIENCE)
    until(
        lambda: all(state_of(client, i)["status"] == Status.SAFE_STOP for i in (1, 2, 3)), "all robots stop", PATIENCE
    )
    client.until_healthy("parent_controller", level=WARN)
    assert [0, EventKind.MODE_CHANGED, "stop commanded"] in client.look()["events"]

    assert client.trigger("swarm/reset") == [True, ""]
    until(lambda: all(follows(client, i) for i in (1, 2, 3)), "all robots follow again", PATIENCE)
    assert client.look()["modes"] == [Mode.RUN, Mode.STOP, Mode.RESET, Mode.RUN]

    assert client.trigger("agent_002/leave") == [True, ""]
    until(lambda: client.look()["newest"]["swarm/abstract_state"]["agent_count"] == 2, "its weight is gone", PATIENCE)
    assert follows(client, 1)
    assert client.trigger("agent_002/join") == [True, ""]
    until(lambda: follows(client, 2), "the robot takes part again", PATIENCE)

    assert [name for name, node in nodes.items() if node.terminate()] == []
    assert client.look()["repeated"] == 0


def test_a_node_that_stands_still_does_not_stop_the_others_and_comes_back(network: Network) -> None:
    client = network.client()
    nodes = start_swarm(network)
    client.until_healthy(*nodes)
    until(lambda: client.look()["alive"].get(AGENT) == 3, "three robots are alive", PATIENCE)

    os.kill(nodes["agent_002"].pid, signal.SIGSTOP)
    until(lambda: client.look()["alive"][AGENT] == 2, "the middleware notices", PATIENCE)
    until(lambda: [2, EventKind.DEAD, "silent"] in client.look()["events"], "the observer says so", PATIENCE)
    steps = {i: state_of(client, i)["step"] for i in (1, 2, 3)}
    until(
        lambda: all(follows(client, i) and state_of(client, i)["step"] > steps[i] + 100 for i in (1, 3)),
        "the others go on",
        PATIENCE,
    )
    assert state_of(client, 2)["step"] == steps[2]
    until(lambda: "agent_002" not in client.nodes(), "the middleware forgets the node", PATIENCE)

    os.kill(nodes["agent_002"].pid, signal.SIGCONT)
    until(lambda: follows(client, 2) and state_of(client, 2)["step"] > steps[2] + 100, "it comes back", PATIENCE)
    until(lambda: client.look()["alive"][AGENT] == 3, "the middleware notices", PATIENCE)
    client.until_healthy(*nodes)
    # Diagnostics come once a second.
    until(lambda: int(client.health("agent_002")["values"]["periods missed"]) > 0, "it says so", PATIENCE)
    assert client.look()["repeated"] == 0


def test_systemd_is_told(network: Network, tmp_path: Path) -> None:
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
        channel.bind(str(path))
        channel.settimeout(PATIENCE)
        environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "200000"}
        node = network.start("plane_sim.realtime", "plane_sim", environment)
        said: list[str] = []
        while said.count("WATCHDOG=1") < 3 or "READY=1\nSTATUS=active" not in said:
            said.append(channel.recv(100).decode())
        assert node.terminate() == 0, node.log()
        while "STOPPING=1" not in said:
            said.append(channel.recv(100).decode())


@pytest.mark.parametrize(
    ("module", "parameters", "problem"),
    [
        ("agent_node.realtime", {"mass": -1.0}, "parameter mass: "),
        ("agent_node.realtime", {"drive__type": "rockets"}, "parameter drive.type: "),
        ("plane_sim.realtime", {"use_sim_time": "true"}, "parameter use_sim_time: "),
        ("plane_sim.realtime", {"last_step": 5}, "parameter last_step: "),
        ("parent_controller.realtime", {"start_mode": "go"}, "parameter start_mode: "),
        ("abstraction_observer.realtime", {"start": "quorum", "quorum": 9}, "parameter quorum: "),
    ],
)
def test_what_makes_no_sense_is_refused(
    network: Network, module: str, parameters: dict[str, object], problem: str
) -> None:
    node = network.start(module, "node", **parameters)
    assert node.wait() == 2
    log = node.log()
    (line,) = (line for line in log.splitlines() if line.startswith("error: "))
    assert line.startswith(f"error: {problem}")
    assert "Traceback" not in log
