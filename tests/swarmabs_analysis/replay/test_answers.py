"""Nodes under test in a playback: what is left to them, what is expected when, and how their answers are compared."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_analysis.replay.answers import Answers
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.writer import BagWriter
from swarmabs_core import messages as msg
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import InputError
from swarmabs_core.nodes import NodeName

FAULTS = "faults=[{at: 0.2, kind: kill, agent: 3}]"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> BagReader:
    """Return the bag of a run of 31 steps in which robot 3 is killed."""
    return open_bag(record(tmp_path_factory.mktemp("recorded") / "run", "pd_het_4", "duration=0.3", FAULTS))


def answers(bag: BagReader, *nodes: str) -> Answers:
    return Answers(bag, [NodeName.parse(node) for node in nodes])


def recorded(bag: BagReader, tested: Answers) -> Iterator[msg.Message]:
    for channel, stored in tested.in_causal_order(bag):
        assert channel.topic is not None
        yield decode(channel.topic.message, stored.payload)


def topics(messages: Iterable[msg.Message]) -> set[str]:
    return {msg.TOPIC_OF[type(message)].name for message in messages}


def test_all_is_played_but_what_the_nodes_publish(bag: BagReader) -> None:
    tested = answers(bag, "controller", "agent:2")
    left, played = [], []
    for message in recorded(bag, tested):
        (left if tested.replaces(message) else played).append(message)
    robots = {m.agent_id for m in played if isinstance(m, msg.AgentState)}
    assert (robots, {m.agent_id for m in left if isinstance(m, msg.AgentState)}) == ({1, 3, 4}, {2})
    assert topics(left) == {"swarm/desired_abstract_state", "swarm/agent_state"}
    assert topics(played) == {
        *("swarm/agent_state", "plane/state", "swarm/abstract_state", "swarm/auxiliary_state"),
        *("swarm/standing", "swarm/events"),
    }
    assert len(left) == 2 * 31 == len(tested.missing())
    assert tested.not_played == {msg.DESIRED_ABSTRACT_STATE}


def test_each_cause_precedes_its_effect(bag: BagReader) -> None:
    """An observer that drops a robot says so before the plane can go on, whatever the order of the file."""
    order = [(m.step, msg.TOPIC_OF[type(m)].name) for m in recorded(bag, answers(bag, "controller"))]
    causes = {name: place for place, name in enumerate(("swarm/events", "swarm/agent_state", "plane/state"))}
    causes |= {"swarm/abstract_state": 3, "swarm/auxiliary_state": 3, "swarm/standing": 4}
    causes["swarm/desired_abstract_state"] = 5
    places = [(step, causes[name]) for step, name in order]
    assert places == sorted(places)
    assert order[0][1] != order[-1][1]
    assert "swarm/events" in {name for step, name in order if step == 21}


def test_answers_may_come_early_twice_or_late_and_are_the_same(bag: BagReader) -> None:
    tested = answers(bag, "observer", "agent:3")
    for message in recorded(bag, tested):
        early = message.step % 2 == 0
        if early:
            tested.hear(message) if topics([message]) & {t.name for t in tested.topics} else None
        if tested.replaces(message) and not isinstance(message, msg.SwarmEvent):
            assert bool(tested.missing()) is not early
            tested.hear(message)
            tested.hear(message._replace(stamp=1))  # a step that was heard before
        assert tested.missing() == ()
    document = tested.to_dict()
    assert (document["same"], document["first_difference"], document["deviations"]) == (True, None, [])
    states = sum(1 for m in recorded(bag, tested) if isinstance(m, msg.AgentState) and m.agent_id == 3)
    standing = sum(1 for m in recorded(bag, tested) if isinstance(m, msg.StandingState))
    assert document["compared"] == 2 * 31 + states + standing
    assert (states, standing > 0) == (21, True)


def test_the_first_difference_and_the_deviation_of_each_field_are_reported(bag: BagReader) -> None:
    tested = answers(bag, "controller")
    for message in recorded(bag, tested):
        if tested.replaces(message):
            assert isinstance(message, msg.DesiredAbstractState)
            assert tested.missing() == (f"step {message.step} of swarm/desired_abstract_state",)
            if message.step < 30:  # it does not answer to the last one
                tested.hear(message._replace(torque=message.torque + 0.25 * (message.step in {7, 9})))
    document = tested.to_dict()
    first = document["first_difference"]
    assert (first["step"], first["topic"], first["field"]) == (7, "swarm/desired_abstract_state", "torque")
    assert first["replayed"] - first["recorded"] == pytest.approx(0.25)
    (torque,) = document["deviations"]
    assert (torque["field"], torque["differing"], document["compared"], document["same"]) == ("torque", 2, 30, False)


def test_an_answer_that_is_missing_is_not_the_same(bag: BagReader) -> None:
    tested = answers(bag, "parent")
    for message in recorded(bag, tested):
        if tested.replaces(message) and message.step < 30:
            tested.hear(message)
    assert (tested.to_dict()["first_difference"], tested.to_dict()["same"]) == (None, False)


def test_a_bag_without_the_topic_of_a_node_is_rejected(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", topics=(msg.PLANE_STATE,), attachments={}) as writer:
        state = msg.PlaneState(0, 0, *([0.0] * (len(msg.PlaneState._fields) - 2)))
        writer.write(msg.PLANE_STATE, 0, encode(state))
    with pytest.raises(InputError, match=r"--node controller: .* has no topic of this node"):
        answers(open_bag(tmp_path / "bag"), "parent", "controller")
