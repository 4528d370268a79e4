"""Third parties that speak for others: they are refused and named, and `verify` reports them."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.processes import until
from tests.system import helpers as runs
from tests.system.forger import ANGLE, FORGED
from tests.system.realtime import PATIENCE, Client, Network, realtime_network, start_swarm, started_client

from swarmabs_bag.reader import open_bag
from swarmabs_core.messages import EVENTS, PLANE_STATE, EventKind, PlaneState, SwarmEvent
from swarmabs_core.realtime.base import Level
from swarmabs_core.realtime.validation import SECOND_SENDER
from swarmabs_run.orchestration.run_files import environment_of_run

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]

COORDINATORS = ("abstraction_observer", "plane_sim")


@pytest.fixture
def network(tmp_path: Path) -> Iterator[Network]:
    with realtime_network(tmp_path) as network:
        yield network


def angle(client: Client) -> float:
    values = client.health("plane_sim").get("values", {})
    return abs(float(values.get("angle, rad", "inf")))


def refused(client: Client) -> int:
    """Return how many states the observer has refused."""
    return int(client.health("abstraction_observer")["values"]["refused"])


def test_a_second_process_with_the_id_of_a_robot_is_refused_and_changes_nothing(network: Network) -> None:
    client = network.client()
    nodes = start_swarm(network)
    client.until_healthy(*nodes)
    until(lambda: angle(client) < 0.01, "the plane is level", PATIENCE)

    second = network.start("agent_node.realtime", "second", agent_id=3, position=0.45, swarm_mass=1.5)
    reason = [0, EventKind.REFUSED, f"robot 3: {SECOND_SENDER}"]
    until(lambda: client.look()["events"].count(reason) == len(COORDINATORS), "both name it", PATIENCE)
    until(lambda: refused(client) > 200, "it keeps sending", PATIENCE)
    until(lambda: client.is_healthy("abstraction_observer", Level.WARN), "the health shows it", PATIENCE)
    for name in COORDINATORS:
        health = client.health(name)
        assert "a second sender speaks for robots 3" in health["message"]
        assert "second sender of robot 3" in health["values"]
    assert "3 of 3 robots follow" in client.health("abstraction_observer")["message"]
    assert angle(client) < 0.02

    second.terminate()
    client.until_healthy(*nodes)  # it is forgotten some time after its last state
    assert angle(client) < 0.02


def test_a_third_party_on_the_topic_of_the_plane_enters_no_bag_and_is_reported(folder: Path) -> None:
    names: set[str] = set()

    def attack() -> None:
        with started_client(environment_of_run(folder), "forger") as forger:
            forger.forge(ANGLE)
            until(lambda: forger.sent() > 100, "it forges", PATIENCE)

            def named() -> bool:
                diagnostics = forger.look()["diagnostics"]
                text = "a second sender speaks for plane/state"
                names.update(name for name, health in diagnostics.items() if text in health["message"])
                return names >= {"parent_controller", "recorder"}

            until(named, "nodes and recorder name it", PATIENCE)
            runs.interrupt()

    outcome = runs.realtime(folder, runs.FOREVER, on_progress=runs.at({100: attack}))
    assert outcome.status == "interrupted"
    recorded = [record.message for record in open_bag(folder).records((PLANE_STATE, EVENTS))]
    assert all(message.angle != ANGLE for message in recorded if isinstance(message, PlaneState))
    events = [message for message in recorded if isinstance(message, SwarmEvent)]
    assert all(event.detail != FORGED for event in events)
    told = [event for event in events if event.kind == EventKind.REFUSED]
    assert 0 < len(told) < 50
    assert any(event.detail.startswith("swarm/events: an event of a process") for event in told)
    verdict = runs.swarm("verify", folder, "--json")
    assert verdict.code == 1
    assert (verdict.summary()["first_difference"], list(verdict.summary()["second_senders"])) == (
        None,
        ["/plane/state"],
    )
