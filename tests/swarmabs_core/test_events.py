"""Codes of events: what made them, read from their bytes."""

import re

import pytest

from swarmabs_core.events import EventCode, code_of, said_event
from swarmabs_core.membership import ChangeKind
from swarmabs_core.messages import EventKind, SwarmEvent
from swarmabs_core.nodes import NodeKind


@pytest.mark.parametrize("code", EventCode)
def test_events_are_read_with_the_code_that_they_are_made_with(code: EventCode) -> None:
    robot = 0 if code is EventCode.REFUSED else 3
    parts = dict.fromkeys(re.findall(r"{(\w+)}", code.text), "of x (1.5 m)\n y")
    made = code.event(7, 1, 0.5, robot=robot, **parts)
    assert made[:5] == (7, 1, robot, code.kind, 0.5)
    assert (code_of(made), code.read(made)) == (code, parts)
    told = code_of(made._replace(detail="what no version has said of it"))
    assert told is not None, "a later version may say more"
    assert told.kind is code.kind
    of_none = code_of(made._replace(agent_id=0))
    assert of_none is None or of_none.source is not NodeKind.AGENT, "robots report about themselves alone"


def test_an_event_of_a_later_version_has_no_code() -> None:
    unknown = SwarmEvent(0, 1, 0, EventKind.REFUSED, 2.0, "two different states of a step")._replace(kind=99)
    assert (code_of(unknown), said_event(unknown)) == (None, "event 99")


def test_the_ends_of_robots_have_the_words_of_their_changes() -> None:
    codes = {
        EventCode.KILLED: ChangeKind.KILL,
        EventCode.FROZEN: ChangeKind.FREEZE,
        EventCode.REMOVED: ChangeKind.REMOVE,
    }
    assert {code.text: (code.kind is EventKind.DEAD) for code in codes} == {
        kind.value: kind.stays for kind in codes.values()
    }
