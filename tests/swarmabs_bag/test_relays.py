"""Relays in bags: all of them, before the other messages of their step, whatever order they arrive in."""

from itertools import groupby
from pathlib import Path
from random import Random

import pytest
from tests.swarmabs_core.helpers import builtin, digest, singly

from swarmabs_bag.reader import open_bag
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.repair.completeness import complete_steps
from swarmabs_bag.run.gatherer import RunCollector
from swarmabs_bag.run.step import Step
from swarmabs_bag.run.writer import BagWriter
from swarmabs_config import configure
from swarmabs_config.scenario import Scenario
from swarmabs_core.behaviours.base import ConflictError, UnknownAgentError
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import Relay, Topic, relay_topic, relay_topic_in
from swarmabs_core.record import Record
from swarmabs_run.simulation import Network, Simulation, peers_in_process

ENDS = "faults=[{kind: join, agent: 4, at: 0.05}, {kind: kill, agent: 2, at: 0.1}, {kind: leave, agent: 1, at: 0.15}]"
SCENARIO = builtin("pd_het_4", "duration=0.2", "coordination=each_robot", "links={loss: 0.5}", ENDS).resolved()


def sent(scenario: Scenario) -> list[bytes]:
    """Run all nodes; return the relays up to the last step by step, round and robot."""
    network = Network(peers_in_process(scenario).values())
    network.start()
    relays = [m for m in network.deliver() if isinstance(m, Relay) and m.step <= scenario.steps]
    return [encode(relay) for relay in sorted(relays, key=lambda relay: (relay.step, relay.round, relay.agent_id))]


def collector(scenario: Scenario) -> RunCollector:
    ends = configure.schedule(scenario)
    division = configure.division(scenario)
    return RunCollector(configure.members(scenario), ends, scenario.steps, division=division, relayed=True)


def test_a_bag_holds_every_relay_before_the_other_messages_of_its_step(tmp_path: Path) -> None:
    recording = Recording(SCENARIO, tmp_path / "bag", driver="simulate", namespace="/west")
    for step in Simulation(SCENARIO).steps():
        recording.add(step)
    figures = recording.close()
    bag = open_bag(tmp_path)
    assert bag.namespace == "/west/"
    assert {relay_topic(robot) for robot in range(1, 5)} < {*bag.topics()}
    messages = list(bag.messages())
    assert [payload for topic, _, payload in messages if topic.message is Relay] == sent(SCENARIO)
    for time, of_step in groupby(messages, key=lambda stored: stored[1]):
        relayed = [topic.message is Relay for topic, _, _ in of_step]
        assert relayed == sorted(relayed, reverse=True)
        assert any(relayed), time
    central = builtin("pd_het_4", "duration=0.2", ENDS)
    assert figures["digest"] == digest(Simulation(central).steps())
    complete = complete_steps(tmp_path)
    assert complete is not None
    assert complete.last_complete == SCENARIO.steps


def test_relays_of_a_damaged_bag_are_missed_by_step(tmp_path: Path) -> None:
    """Robot 3 lacks its relay of a middle round of step 7: that step is not complete."""
    steps = singly(Simulation(SCENARIO).steps())
    whole = Recording(SCENARIO, tmp_path / "whole", driver="simulate")
    for step in steps:
        whole.add(step)
    whole.close()
    source = open_bag(tmp_path / "whole")
    attached = {name: source.attachment(name) or b"" for name in ("scenario.yaml", "provenance.json")}
    topics = source.topics()
    with BagWriter(tmp_path / "lacking", topics=topics, attachments=attached) as writer:
        for topic, time, payload in source.messages():
            message = decode(topic.message, payload)
            if not (isinstance(message, Relay) and (message.step, message.agent_id, message.round) == (7, 3, 1)):
                writer.write(topic, time, payload)
    complete = complete_steps(tmp_path / "lacking")
    assert complete is not None
    assert (complete.last_complete, complete.by_topic["/agent_003/relay"]) == (6, 6)
    assert complete.by_topic["/agent_001/relay"] >= 15  # it leaves there


def test_relays_may_arrive_in_any_order_and_again() -> None:
    steps = singly(Simulation(SCENARIO).steps())
    for seed in range(5):
        draw, gathered = Random(seed), collector(SCENARIO)
        waiting = [
            (step.step + 3 * draw.random(), n, record) for step in steps for n, record in enumerate(step.records)
        ]
        waiting += draw.sample(waiting, len(waiting) // 4)
        found: list[Step] = []
        for _, _, record in sorted(waiting, key=lambda place: place[0]):
            found += gathered.add_all(record.topic, [record.payload])
        assert gathered.finished
        gathered_steps = [Step(step.first, step.tables, relays=step.relays) for step in found if step.tables]
        assert gathered_steps == [Step(step.first, step.tables, relays=step.relays) for step in steps]


def records(step: Step, *without: tuple[int, int]) -> list[tuple[Topic, bytes]]:
    """Return the messages of a step but for the relays of these robots and rounds."""
    stored = []
    for record in step.records:
        message = record.message
        if not (isinstance(message, Relay) and (message.agent_id, message.round) in without):
            stored.append((record.topic, record.payload))
    return stored


@pytest.mark.parametrize("round_", [0, 1])
def test_a_step_is_complete_with_the_last_of_its_relays(round_: int) -> None:
    first = singly(Simulation(SCENARIO).steps())[0]
    gathered = collector(SCENARIO)
    for topic, payload in records(first, (3, round_)):
        assert not list(gathered.add_all(topic, [payload]))
    assert gathered.missing() == ("agent 3",)
    late = next(record for record in first.records if record.message[2:4] == (3, round_))
    assert list(gathered.add_all(late.topic, [late.payload])) == [first]


def test_a_relay_that_differs_or_comes_from_a_stranger_is_an_error() -> None:
    gathered, relay = collector(SCENARIO), decode(Relay, sent(SCENARIO)[2])
    assert isinstance(relay, Relay)
    gathered.add(Record.of(relay))
    with pytest.raises(ConflictError, match="agent_003/relay in round 0"):
        gathered.add(Record.of(relay._replace(complete=1)))
    with pytest.raises(UnknownAgentError):
        gathered.add(Record.of(relay._replace(agent_id=9)))


def test_topics_of_relays_are_known_by_name() -> None:
    assert relay_topic_in("/west/agent_003/relay") is relay_topic(3)
    assert relay_topic_in("/agent_1234/relay") is relay_topic(1234)
    for strange in ("/agent_003/state", "/agent_03/relay", "/agent_0003/relay", "/an_agent_003/relay", "/relay"):
        assert relay_topic_in(strange) is None
