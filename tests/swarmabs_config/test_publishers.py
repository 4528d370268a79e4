"""Who publishes what."""

import pytest
from tests.swarmabs_core.helpers import agent_state, broadcasts
from tests.swarmabs_core.test_messages import ROBOT, SWARM

from swarmabs_config.publishers import publisher_of
from swarmabs_core import messages as msg
from swarmabs_core.nodes import NodeName


def event(kind: msg.EventKind, detail: str = "") -> msg.SwarmEvent:
    return msg.SwarmEvent(0, 1, 3, kind, 0.5, detail)


@pytest.mark.parametrize(
    ("message", "publisher"),
    [
        (agent_state(258), "agent:258"),
        (msg.PlaneState(0, 0, 0.1, 0.2), "parent"),
        *zip(broadcasts(), ("observer", "observer", "controller"), strict=True),
        (ROBOT, f"agent:{ROBOT.agent_id}"),
        *zip(SWARM, ("observer", "observer", "controller"), strict=True),
        (msg.ParentState(0, 0, 7, (0.1,)), "parent"),
        (msg.SystemDescription(0, 0, 7, "{}"), "parent"),
        *(
            (event(msg.EventKind.LIMIT_HIT, f"{need} limited")._replace(agent_id=0), "controller")
            for need in ("torque", "command")
        ),
        *((event(kind), "observer") for kind in (msg.EventKind.JOINED, msg.EventKind.LEFT, msg.EventKind.DEAD)),
        *(
            (event(kind), "agent:3")
            for kind in (msg.EventKind.SAFE_STOP, msg.EventKind.RECOVERED, msg.EventKind.FAULT_INJECTED)
        ),
        (event(msg.EventKind.LIMIT_HIT, "command limited"), "agent:3"),
        (event(msg.EventKind.LIMIT_HIT, "torque limited to torque_max"), "controller"),
        (event(msg.EventKind.LIMIT_HIT, "end stop hit"), "parent"),
        (event(msg.EventKind.STEERING, "disturbance"), "parent"),
        (event(msg.EventKind.STEERING, "reference"), "controller"),
        (event(msg.EventKind.MODE_CHANGED), "controller"),
        (event(msg.EventKind.LEADING, "parent_controller_standby: peer silent"), "controller"),
        (event(msg.EventKind.LEADING, "abstraction_observer: peer silent"), "observer"),
    ],
)
def test_each_message_has_one_publisher(message: msg.Message, publisher: str) -> None:
    assert str(publisher_of(message)) == publisher
    assert NodeName.parse(publisher) == publisher_of(message)


def test_an_event_without_a_robot_may_not_tell_its_publisher() -> None:
    refused = msg.SwarmEvent(0, 1, 0, msg.EventKind.REFUSED, 2.0, "two different states of a step")
    assert publisher_of(refused) is None
    assert str(publisher_of(refused._replace(agent_id=3))) == "agent:3"
    assert publisher_of(refused._replace(kind=99)) is None
