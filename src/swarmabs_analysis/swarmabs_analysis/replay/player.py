"""The player of a recorded run, which replaces all nodes other than those under test.

It publishes recorded messages, so a replay is open loop: only other nodes under test react to the answers of the nodes
under test.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.behaviours.base import StepAheadError, UnexpectedMessageError
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    EVENTS,
    NEVER,
    PLANE_FAMILY,
    RECORDING_PROGRESS,
    STANDING,
    TOPIC_OF,
    Family,
    Message,
    Messages,
    RecordingProgress,
    Topic,
)
from swarmabs_core.publishers import PUBLISHER, NodeKind, NodeName, publisher_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from swarmabs_bag.run.step import Step
    from swarmabs_core.record import Record


def answered(live: Collection[NodeName], family: Family = PLANE_FAMILY) -> tuple[Topic, ...]:
    """Return the topics on which the nodes under test answer."""
    robots = any(name.kind is NodeKind.AGENT for name in live)
    topics = (*family.main, *family.once, STANDING)
    return tuple(topic for topic in topics if (topic is family.robot and robots) or PUBLISHER.get(topic) in live)


def played(live: Collection[NodeName], family: Family = PLANE_FAMILY) -> tuple[Topic, ...]:
    """Return the topics that the player publishes: all others, and those of robots and events, which are shared."""
    others = set(answered(live, family)) - {family.robot}
    return (EVENTS, *(topic for topic in (*family.main, *family.once, STANDING) if topic not in others))


class _Key(NamedTuple):
    """Key of an awaited message."""

    step: int
    topic: Topic
    agent_id: int


class _Phase(NamedTuple):
    """Messages published together, and the messages awaited afterwards; `played` are the topics of the former."""

    step: int
    messages: Messages
    played: frozenset[Topic]
    awaited: frozenset[_Key]


class Player:
    """Publishes a recorded run step by step, and waits for the nodes under test in each step.

    A step has two phases: the robots' states with the events, then the coordinators' broadcasts. After each phase the
    player waits for the messages that the recording contains from the nodes under test. Each node therefore is in the
    step of the messages that it receives, and loses nothing: a lost message is repeated because a node waits for it.

    Nodes under test that only need each other's messages do not wait for the player; it may be any number of steps
    behind them and miss some of their messages. An answer therefore confirms all earlier ones of its publisher. The
    player checks instead that no node has answered a message that is only published now.

    The recorded steps are in order, up to `last_step`, which ends the replay. The player may be `window` steps ahead of
    the recorder; 0 means that no recorder reports its progress. `family` are the topics of the run, `hears` those to
    subscribe to.
    """

    def __init__(
        self,
        steps: Iterator[Step],
        live: Collection[NodeName],
        *,
        last_step: int,
        window: int = 0,
        family: Family = PLANE_FAMILY,
    ) -> None:
        self._family = family
        self._gathered_by = (family.parent, family.abstract, family.auxiliary)
        self._steps = steps
        self._live = frozenset(live)
        self._last_step = last_step
        self._window = window
        self._written = -1
        self._step = -1
        self._phases: deque[_Phase] = deque()
        self._awaited: frozenset[_Key] = frozenset()
        self._heard: dict[tuple[Topic, int], int] = {}
        self._newest: dict[Topic, Message] = {}
        answers = answered(live, family)
        self.hears = (*answers, RECORDING_PROGRESS) if window else answers

    def start(self) -> Messages:
        """Publish the messages before the first answer."""
        return self._proceed()

    def handle(self, message: Message) -> Messages:
        """Process an answer of a node under test, or the recorder's progress; return the next recorded messages."""
        topic = TOPIC_OF[type(message)]
        if topic not in self.hears:
            raise UnexpectedMessageError("player", message)
        if isinstance(message, RecordingProgress):
            if message.written_step != NEVER:
                self._written = max(self._written, message.written_step)
            return self._proceed()
        publisher = publisher_of(message)
        if publisher not in self._live:  # its own message, on a topic shared with a node under test
            return ()
        if message.step > self._last_step:
            raise StepAheadError(str(publisher), got=message.step, expected=self._last_step)
        key = (topic, publisher.agent_id)
        if message.step <= self._heard.get(key, -1):
            return ()
        self._heard[key] = message.step
        if topic not in self._newest or message.step > self._newest[topic].step:
            self._newest[topic] = message
        return self._proceed()

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the nodes under test, then, if the recorder is too far behind, for the recorder."""
        missing = {key.topic for key in self._lacking()}
        if missing:
            others = self._gathered_by if self._family.robot in missing else ()
            return tuple(topic for topic in self.hears if topic in missing or topic in others)
        return () if self._finished() else (RECORDING_PROGRESS,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and what is missing for it."""
        keys = sorted(self._lacking(), key=lambda key: (key.topic.name, key.agent_id))
        if not keys:
            return self._step + 1, () if self._finished() else ("recorder",)
        return self._step, tuple(f"agent {key.agent_id}" if key.agent_id else key.topic.name for key in keys)

    def _finished(self) -> bool:
        return self._step >= self._last_step and not self._phases

    def _lacking(self) -> list[_Key]:
        """Return the awaited messages that are not known to have been sent."""
        return [key for key in self._awaited if not self._said(key)]

    def _said(self, key: _Key) -> bool:
        """Return whether a message was received, or another one that implies it.

        A robot that has ended repeats nothing, but a coordinator's answer implies the states of all robots of its step.
        """
        if self._heard.get((key.topic, key.agent_id), -1) >= key.step:
            return True
        if key.topic is not self._family.robot:
            return False
        return any(self._newest[topic].step >= key.step for topic in self._gathered_by if topic in self._newest)

    def _proceed(self) -> Messages:
        """Publish phase by phase until an awaited message is missing."""
        out: list[Message] = []
        while all(map(self._said, self._awaited)) and (self._phases or self._next_step()):
            self._refuse_early(self._phases[0])
            _, messages, _, self._awaited = self._phases.popleft()
            out.extend(messages)
        return tuple(out)

    def _refuse_early(self, phase: _Phase) -> None:
        """Raise `StepAheadError` for answers to messages that are only published now."""
        family = self._family
        latest = dict.fromkeys(self._gathered_by, phase.step - 1) if family.robot in phase.played else {}
        if phase.played & {family.robot, family.parent}:
            latest[family.desired] = phase.step - 1
        if phase.played:
            latest[family.robot] = phase.step
        for topic, step in latest.items():
            heard = self._newest.get(topic)
            if heard is not None and heard.step > step:
                raise StepAheadError(str(publisher_of(heard)), got=heard.step, expected=step)

    def _next_step(self) -> bool:
        """Load the next recorded step; return False if there is none or the recorder is too far behind."""
        if self._finished() or (self._window and self._step + 1 - self._window > self._written):
            return False
        step = next(self._steps, None)
        if step is None:
            raise RunError(f"the recording ends with step {self._step}, before step {self._last_step}")
        self._step = max(self._step, step.step)  # an event that was recorded late is of an earlier step
        events, robots = ([r for r in step.records if r.topic is topic] for topic in (EVENTS, self._family.robot))
        coordinators = [r for r in step.records if r.topic not in {EVENTS, self._family.robot}]
        others = events + robots  # an event precedes the states that it explains
        self._phases.extend((self._phase(step.step, others), self._phase(step.step, coordinators)))
        return True

    def _phase(self, step: int, records: Collection[Record]) -> _Phase:
        played, awaited = [], set()
        for record in records:
            if publisher_of(record.message) not in self._live:
                played.append(record.message)
            elif record.topic is not EVENTS:
                awaited.add(_Key(record.message.step, record.topic, record.agent_id))
        topics = frozenset(TOPIC_OF[type(message)] for message in played) - {EVENTS}
        return _Phase(step, tuple(played), topics, frozenset(awaited))
