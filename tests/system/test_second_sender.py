"""A third party that speaks for others: it is refused and named, and `verify` reports it."""

from pathlib import Path

import pytest
from tests.processes import until
from tests.system import helpers as runs
from tests.system.forger import ANGLE, FORGED
from tests.system.realtime import PATIENCE, started_client

from swarmabs_bag.reader import open_bag
from swarmabs_core.messages import EVENTS, PLANE_STATE, EventKind, PlaneState, SwarmEvent
from swarmabs_run.orchestration.run_files import environment_of_run

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]


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
