"""The messages that nodes under test publish in a playback, in place of the recorded ones."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, TypedDict

from swarmabs_analysis.comparison.messages import MessageComparison
from swarmabs_bag.attached import is_realtime
from swarmabs_config.publishers import PUBLISHER, publisher_of
from swarmabs_core.errors import InputError
from swarmabs_core.messages import EVENTS, TOPIC_OF
from swarmabs_core.nodes import NodeKind
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from swarmabs_analysis.comparison.messages import Deviation
    from swarmabs_bag.mcap.records import StoredMessage
    from swarmabs_bag.reader import BagReader
    from swarmabs_bag.run.metadata import BagChannel
    from swarmabs_core.messages import Message, Topic
    from swarmabs_core.nodes import NodeName

_Key = tuple["Topic", int, int]


class Comparison(TypedDict):
    """How the answers of nodes under test differ from a recording, as plain data for JSON."""

    nodes: list[str]
    compared: int
    same: bool
    first_difference: dict[str, object] | None
    deviations: list[dict[str, Deviation]]


class Answers:
    """Compares what nodes under test publish with what a bag holds of them.

    A recorded message of such a node is expected from it, once everything before it has been played; `missing` are the
    expected messages that have not been heard. Messages of the nodes are numbered: one that is heard again, or that is
    of an earlier step than the last, is ignored. Their events are neither played nor expected.

    Attributes
    ----------
    topics : tuple of Topic
        What they publish, without events; the topic of robots also carries what others publish.
    not_played : frozenset of Topic
        Those on which only they publish.

    Parameters
    ----------
    bag : BagReader
        A recorded run in lockstep; in real time an answer depends on when messages arrive.
    nodes : collection of NodeName
        The nodes under test.

    Raises
    ------
    InputError
        If the bag is of a run in real time, or has no messages of a node.
    """

    def __init__(self, bag: BagReader, nodes: Collection[NodeName]) -> None:
        if is_realtime(bag):
            raise InputError(
                f"{bag.path} was recorded in real time: the answer of a node depends on when messages arrive, so no "
                "node can be tested against it; leave out --node, and select with --topics what is played"
            )
        family = bag.family
        self._nodes = tuple(nodes)
        robots = any(node.kind is NodeKind.AGENT for node in nodes)
        causes_first = (EVENTS, *family.recorded)
        self._order = {topic: place for place, topic in enumerate(causes_first)}
        self.topics = tuple(
            topic
            for topic in causes_first
            if topic in bag.topics() and ((topic is family.robot and robots) or PUBLISHER.get(topic) in nodes)
        )
        self.not_played = frozenset(self.topics) - {family.robot}
        self._check(bag)
        self._expected: dict[_Key, Record] = {}
        self._early: dict[_Key, Record] = {}
        self._newest: dict[tuple[Topic, int], int] = {}
        self._comparison = MessageComparison()

    def _check(self, bag: BagReader) -> None:
        for node in self._nodes:
            if not any(node.kind is NodeKind.AGENT or PUBLISHER.get(topic) == node for topic in self.topics):
                raise InputError(f"--node {node}: {bag.path} has no topic of this node; leave out --node")

    def in_causal_order(self, bag: BagReader) -> Iterator[tuple[BagChannel, StoredMessage]]:
        """Yield the stored messages of a bag such that within a step the cause of a message precedes it."""
        for _, of_step in groupby(bag.stored_messages(), key=lambda stored: stored[1].log_time):
            yield from sorted(of_step, key=lambda stored: self._place(stored[0]))

    def _place(self, channel: BagChannel) -> int:
        return 0 if channel.topic is None else self._order.get(channel.topic, 0)

    def replaces(self, recorded: Message) -> bool:
        """Return whether a recorded message is of a node under test, which is expected to publish it from now on."""
        topic = TOPIC_OF[type(recorded)]
        if topic not in (*self.topics, EVENTS) or publisher_of(recorded) not in self._nodes:
            return False
        if topic is not EVENTS:
            self._take(Record.of(recorded), self._expected, self._early)
        return True

    def hear(self, message: Message) -> None:
        """Process a message on one of the topics; those of other nodes are ignored."""
        if publisher_of(message) not in self._nodes:
            return
        record = Record.of(message)
        place = (record.topic, record.agent_id)
        if message.step > self._newest.get(place, -1):
            self._newest[place] = message.step
            self._take(record, self._early, self._expected)

    def _take(self, record: Record, own: dict[_Key, Record], others: dict[_Key, Record]) -> None:
        """Compare a message with its counterpart, or keep it until that is known."""
        key = (record.topic, record.message.step, record.agent_id)
        other = others.pop(key, None)
        if other is None:
            own[key] = record
        else:
            recorded, heard = (other, record) if own is self._early else (record, other)
            self._comparison.take(recorded, heard)

    def missing(self) -> tuple[str, ...]:
        """Return what is expected and has not been heard."""
        return tuple(
            f"step {step} of {f'robot {agent_id}' if agent_id else topic.name}"
            for topic, step, agent_id in self._expected
        )

    def to_dict(self) -> Comparison:
        """Return the comparison of the messages heard so far."""
        comparison = self._comparison.finish()
        first = comparison.first
        return {
            "nodes": list(map(str, self._nodes)),
            "compared": sum(topic.compared for topic in comparison.topics),
            "same": first is None and not self._expected,
            "first_difference": first and first.to_dict("recorded", "replayed"),
            "deviations": comparison.deviations(),
        }
