"""Bags of robots in real time that compute the swarm by themselves: relays, several speakers, and merged bags."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random

from tests.swarmabs_core.helpers import builtin
from tests.virtual.fleet import EPOCH, VirtualFleet

from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.info import bag_info
from swarmabs_bag.merge import MergeReport, merge_bags
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import RealtimeWorld, law_begins
from swarmabs_bag.recorder.recording import RealtimeRecording
from swarmabs_bag.run.realtime_gatherer import RealtimeCollector
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_core import messages as msg
from swarmabs_core.messages import Message, Relay, relay_topic
from swarmabs_core.nodes import agent_name
from swarmabs_core.record import Record

SCENARIO = builtin("arise_het_4", "coordination=each_robot")
CLOCK = configure.schedule(SCENARIO, EPOCH)
Sent = tuple[int, str, Message]
BROADCASTS = {msg.ABSTRACT_STATE, msg.AUXILIARY_STATE, msg.STANDING, msg.DESIRED_ABSTRACT_STATE}


@cache
def published() -> list[Sent]:
    """Run robots of which the first, who speaks, hears nobody for a while; then it dies and returns."""
    fleet = VirtualFleet(SCENARIO)
    fleet.run(0.5)
    fleet.network.cut.add(agent_name(1))
    fleet.run(0.4)
    fleet.network.cut.clear()
    fleet.run(0.3)
    fleet.kill(agent_name(1))
    fleet.run(0.3)
    fleet.revive(agent_name(1))
    fleet.run(0.3)
    return fleet.published


def bag(folder: Path, hears: Callable[[Message], bool] = lambda _: True, delay: Callable[[], int] = lambda: 0) -> Path:
    """Write what a recorder has that hears some messages, each from the writer of its node, some time (ns) later."""
    recording = RealtimeRecording(SCENARIO, folder, RealtimeWorld(CLOCK, members(SCENARIO), plane=True))
    arrived = [(EPOCH + time + delay(), name, message) for time, name, message in published() if hears(message)]
    for time, name, message in sorted(arrived, key=lambda one: one[0]):
        recording.add(Record.of(message), time, name.encode().ljust(12) + type(message).__name__.encode())
    recording.close()
    return folder


def test_while_two_robots_speak_the_first_broadcast_of_a_step_is_recorded(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag")
    speakers: dict[tuple[type[Message], int], set[str]] = {}
    for _, name, message in published():
        speakers.setdefault((type(message), message.step), set()).add(name)
    assert sum(len(names) > 1 for (kind, _), names in speakers.items() if kind is msg.AbstractState) >= 3
    read = open_bag(folder)
    found = [(topic, message) for topic, _, message in read.decoded()]
    for topic in BROADCASTS:
        steps = [message.step for of, message in found if of is topic]
        assert len(steps) == len(set(steps)) > 150
    assert not any("second sender" in message.detail for _, message in found if isinstance(message, msg.SwarmEvent))
    relays = [message for topic, message in found if topic.message is Relay]
    assert relays == [message for _, _, message in published() if isinstance(message, Relay)]
    assert {relay_topic(robot) for robot in members(SCENARIO)} < set(read.topics())
    result = BagToVerify(folder).verify()
    assert (result.difference, result.ok, result.not_read) == (None, True, ())
    assert result.not_checkable.total() < 0.02 * result.messages
    assert "/agent_003/relay" in {topic.name for topic in bag_info(folder).topics}
    begins = law_begins(read)
    assert len({begun for step, begun in begins.items() if step > 10}) == 1


def test_a_second_sender_on_the_relays_of_a_robot_is_refused_and_told() -> None:
    collector = RealtimeCollector(members(SCENARIO), CLOCK, each_robot=True)
    kept = []
    for time, name, message in published():
        if isinstance(message, Relay) and message.step < 50:
            kept += collector.add(Record.of(message), EPOCH + time, name.encode().ljust(12))
            if message.agent_id == 3 and message.step == 20:
                forged = message._replace(content=b"forged")
                kept += collector.add(Record.of(forged), EPOCH + time, b"a stranger..")
    told = [record.message for record in kept if isinstance(record.message, msg.SwarmEvent)]
    assert [(event.agent_id, event.step) for event in told] == [(3, 20)]
    assert "a second sender" in told[0].detail
    assert "agent_003/relay" in told[0].detail
    assert not any(isinstance(record.message, Relay) and record.message.content == b"forged" for record in kept)


def test_what_several_recorders_have_heard_is_merged_and_verifies(tmp_path: Path) -> None:
    """Each misses a third of all messages, none is missed by both, and they hear the two speakers in another order."""
    draw = Random(1)
    misses = {id(message): draw.randrange(3) for _, _, message in published()}
    parts = [
        bag(tmp_path / str(n), lambda message, n=n: misses[id(message)] != n, lambda: draw.randrange(3_000_000))  # type: ignore[misc]
        for n in range(2)
    ]
    report = merge_bags(parts, tmp_path / "new")
    assert (report.gaps, report.contradictions) == ((), ())
    whole = open_bag(bag(tmp_path / "whole"))

    def found(one: object, *, shared: bool) -> set[tuple[msg.Topic, bytes]]:
        return {(topic, payload) for topic, _, payload in one.messages() if (topic in BROADCASTS) is shared}  # type: ignore[attr-defined]

    merged = open_bag(tmp_path / "new")
    assert found(merged, shared=False) == found(whole, shared=False)
    assert len(found(merged, shared=True)) == len(found(whole, shared=True))
    result = BagToVerify(tmp_path / "new").verify()
    assert (result.difference, result.second_senders) == (None, {})
    assert result.not_checkable.total() < 0.02 * result.messages


def test_what_no_recorder_has_heard_of_relays_is_named(tmp_path: Path) -> None:
    def lost(message: Message) -> bool:
        relay = isinstance(message, Relay) and message.agent_id == 3
        state = isinstance(message, msg.AgentState) and message.agent_id == 2
        return (relay and 40 <= message.step < 45) or (state and message.step == 60)

    parts = [
        bag(tmp_path / str(n), lambda message, n=n: not lost(message) and message.step % 3 != n)  # type: ignore[misc]
        for n in range(2)
    ]
    report: MergeReport = merge_bags(parts, tmp_path / "new")
    assert {(gap.topic, gap.robots, gap.first, gap.last) for gap in report.gaps} == {
        ("agent_003/relay", (), 40, 44),
        (msg.AGENT_STATE.name, (2,), 60, 60),
    }
