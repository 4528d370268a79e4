"""The loop that drives a node behaviour in lockstep over DDS, and repeats its messages if nothing arrives.

The loop does not rely on any quality of service: a node that waits too long sends its last messages again.

Work and waiting are separate: the loop's activity does all pending work and yields what it waits for, so a test can act
as clock, network and scheduler of a whole swarm in one thread.
"""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from swarmabs_config.graph import KEPT_STEPS
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import SwarmEvent, topic_of
from swarmabs_ros.announcements import send_events
from swarmabs_ros.inputs import Inputs

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterator, Mapping

    from rclpy.publisher import Publisher

    from swarmabs_config.graph import Endpoints
    from swarmabs_core.behaviours import Behaviour
    from swarmabs_core.messages import Messages, Topic
    from swarmabs_ros.endpoints import Receiver
    from swarmabs_ros.status import StatusChannel

SLICE = 0.1
"""Longest time, s, between checks whether the node must stop."""
FIRST = 0.05
"""Shortest wait before a repetition, s."""
LONGEST = 1.0
"""Longest wait between repetitions, s."""

INTERRUPTED = "interrupted"
"""Argument of `NodeSpec.on_exit` if the user has stopped the node (SIGINT)."""


def silence_limit(stall_timeout: float) -> float:
    """Return how long, s, a node may say nothing, not even repeat itself, before robots without an observer drop it."""
    return stall_timeout + LONGEST


Wait = tuple[tuple["Topic", ...], float]
"""What a loop waits for: a message of one of the topics, and the longest time, s; without topics, only the time."""


@dataclass(frozen=True, slots=True)
class NodeSpec:
    """Specification of a node in lockstep.

    Parameters
    ----------
    endpoints : Endpoints, optional
        Its publications and subscriptions, if they do not follow from the graph and its parameters.
    on_stall : callable, optional
        Reaction of the behaviour to a stall, such as dropping robots. It is called while the stall lasts, once the node
        has waited for the same messages for the stall time.
    on_exit : callable, optional
        Called at the end in any case, with the problem, if there is one, or `INTERRUPTED`.
    lingers : bool
        Whether the node, after its behaviour has finished, repeats its last messages until it is told to stop.
    gather : callable, optional
        Returns the time, s, for which messages are collected before they are handled, for a node that no other node
        waits for.
    on_idle : callable, optional
        Called with the time, s, by the loop's clock when no more messages have arrived, at least every `SLICE` s; it
        may return messages to publish.
    hear : callable, optional
        Takes topic and bytes of a message, for a node that needs the bytes; by default the behaviour takes the message.
    hear_all : callable, optional
        Takes topic and bytes of all messages that have arrived on it, for a node that handles them in batches.
    compares : bool
        Whether the behaviour itself compares the messages that it has used with those that arrive later.
    """

    behaviour: Behaviour
    endpoints: Endpoints | None = None
    on_stall: Callable[[], Messages] | None = None
    on_exit: Callable[[str | None], None] = field(default=lambda _: None)
    lingers: bool = True
    gather: Callable[[], float] | None = None
    on_idle: Callable[[float], Messages | None] | None = None
    hear: Callable[[Topic, bytes], Messages] | None = None
    hear_all: Callable[[Topic, list[bytes]], Messages] | None = None
    compares: bool = False


class RunningClock:
    """Running time of a process, s: time in which the whole run is stopped (SIGSTOP, a debugger) is not a silence.

    At most `LONGEST` counts between two readings of a steady clock; a waiting node reads it every `SLICE`.
    """

    def __init__(self, steady: Callable[[], float] = time.monotonic) -> None:
        self._steady = steady
        self._read, self._time = steady(), 0.0

    def __call__(self) -> float:
        """Return the time since the first reading."""
        now = self._steady()
        self._time += min(now - self._read, LONGEST)
        self._read = now
        return self._time


class Repeater:
    """Decides on repetitions from the times of progress, s, on any clock that does not jump.

    The first repetition follows after four usual step times and repeats one step. If it does not help, more and more
    steps are repeated at longer and longer intervals, because a missing message may be older than the current step. The
    fifth repetition covers all `most` steps and occurs before the silence counts as a stall.

    The shortest wait before a repetition is `first`. It must suit the size of the swarm: steps of a large swarm take
    longer, and repetitions before an answer is possible would only add load.
    """

    def __init__(self, now: float, *, first: float = FIRST, most: int = KEPT_STEPS) -> None:
        self._first = first
        self._longest = max(LONGEST, 4.0 * first)
        self._most = most
        self._usual = first
        self._last = now
        self._interval = 4.0 * first
        self._window = 1
        self._due = now + self._interval

    def progress(self, now: float) -> None:
        """Record that a step was completed."""
        # The usual step time tracks about the 80 % quantile: a lost message delays a step by this wait, but must not
        # lengthen the next wait. Otherwise the nodes would wait longer and longer for each other.
        self._usual = min(self._usual * (1.1 if now - self._last > self._usual else 0.98), self._longest)
        self._interval = min(max(self._first, 4.0 * self._usual), self._longest)
        self._last = now
        self._window = 1
        self._due = now + self._interval

    def wait(self, now: float) -> float:
        """Return the time until the next repetition, s."""
        return max(0.0, self._due - now)

    def due(self, now: float) -> int:
        """Return the number of latest steps to repeat now, 0 for none."""
        if now < self._due:
            return 0
        window = self._window
        self._window = 4 * window if window < self._most else 1
        self._interval = min(1.5 * self._interval, self._longest)
        self._due = now + self._interval
        return min(window, self._most)

    def silence(self, now: float) -> float:
        """Return the time since the last progress, s."""
        return now - self._last


class Lockstep:
    """Passes awaited messages to the behaviour, publishes its answers, and repeats them if nothing arrives.

    The node reads `topics`. A silence of `stall_timeout` s is reported to `status` as a stall; 0 disables this.
    `Repeater` decides on repetitions. `clock` returns a time, s, by default that of a `RunningClock`; `sleep` waits for
    a time, s.
    """

    def __init__(
        self,
        spec: NodeSpec,
        receiver: Receiver,
        publishers: Mapping[Topic, Publisher],
        status: StatusChannel,
        *,
        topics: Collection[Topic],
        stall_timeout: float,
        repeat_after: float = FIRST,
        repeat_steps: int = KEPT_STEPS,
        clock: Callable[[], float] | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._clock, self._sleep = clock or RunningClock(), sleep
        self._spec = spec
        self._behaviour = spec.behaviour
        self._receiver = receiver
        self._publishers = publishers
        self._status = status
        self._stall_timeout = stall_timeout
        self._repeat_after, self._repeat_steps = repeat_after, repeat_steps
        self._repeater: Repeater
        self._hear = spec.hear or self._decoded
        self._inputs = None if spec.compares else Inputs(2 * KEPT_STEPS)
        self._topics = topics
        self._sent: deque[tuple[int, Topic, bytes]] = deque()
        self._stalled = False
        self._waited: tuple[int, tuple[str, ...]] = (-1, ())
        self._waited_since = 0.0
        self._stopping = False

    def stop(self) -> None:
        """Make `run` return soon."""
        self._stopping = True

    def run(self) -> None:
        """Drive the behaviour until `stop` is called, or until it has finished if it does not linger.

        A lingering node whose behaviour has finished keeps repeating its last messages, in case another node still
        needs one. Raises `RunError` if the behaviour cannot continue.
        """
        activity, wait, sleep = self.activity(), self._receiver.wait, self._sleep
        go_on = activity.send
        heard: bool | None = None
        with suppress(StopIteration):
            while True:
                topics, seconds = go_on(heard)
                if topics:
                    heard = wait(topics, seconds)
                else:
                    sleep(seconds)
                    heard = None

    def activity(self) -> Generator[Wait, bool | None, None]:
        """Do the work of `run`, but yield each wait to the caller, who sends back whether a message has arrived."""
        behaviour, spec, clock = self._behaviour, self._spec, self._clock
        repeater = Repeater(clock(), first=self._repeat_after, most=self._repeat_steps)
        self._repeater = repeater
        self._publish(behaviour.start())
        while not self._stopping:
            topics = behaviour.awaits()
            if not topics:
                self._compare_late()
                if not spec.lingers:
                    return
            if self._drain(topics):
                continue
            answer = None if spec.on_idle is None else spec.on_idle(clock())
            if answer:
                self._progress(answer, clock())
            heard = yield topics, min(SLICE, repeater.wait(clock()))
            if heard:
                if spec.gather is not None:
                    yield (), spec.gather()
                continue
            now = clock()
            if topics:
                self._check_stall(now)
            self._repeat(repeater.due(now))
        self._compare_late()

    def _taken(self, topic: Topic) -> bytes | None:
        """Return the next message of a topic; raises `ConflictError` if it differs from another."""
        data = self._receiver.take(topic)
        if data is not None and self._inputs is not None:
            self._inputs.compare(topic, data)
        return data

    def _compare_late(self) -> None:
        """Compare what has arrived after the node has finished with what it has used."""
        for topic in self._topics:
            late = iter(partial(self._taken, topic), None) if self._inputs is not None else self._answers(topic)
            deque(late, maxlen=0)

    def _drain(self, topics: tuple[Topic, ...]) -> bool:
        """Handle messages of these topics while they are the awaited ones; return whether to look again at once.

        A node that handles messages in batches gathers the next one first.
        """
        behaviour, single = self._behaviour, self._spec.hear_all is None
        again = False
        for topic in topics:
            for answer in self._answers(topic):
                again = single
                if answer:
                    self._progress(answer, self._clock())
                if behaviour.awaits() != topics:
                    return True
        return again

    def _answers(self, topic: Topic) -> Iterator[Messages]:
        """Take the messages of a topic, one after the other or all at once, and yield the answers."""
        take, hear, hear_all = self._taken, self._hear, self._spec.hear_all
        if hear_all is not None:
            payloads = list(iter(partial(take, topic), None))
            if payloads:
                yield hear_all(topic, payloads)
            return
        while (data := take(topic)) is not None:
            yield hear(topic, data)

    def _decoded(self, topic: Topic, data: bytes) -> Messages:
        return self._behaviour.handle(decode(topic.message, data))

    def _publish(self, messages: Messages) -> None:
        send_events(self._status, "publishes", [message for message in messages if isinstance(message, SwarmEvent)])
        for message in messages:
            topic = topic_of(message)
            data = encode(message)
            self._publishers[topic].publish(data)
            self._sent.append((message.step, topic, data))
        if self._sent:
            oldest = self._sent[-1][0] - KEPT_STEPS
            while self._sent[0][0] < oldest:
                self._sent.popleft()

    def _repeat(self, steps: int) -> None:
        if not steps or not self._sent:
            return
        newest = self._sent[-1][0]
        for step, topic, data in self._sent:
            if step > newest - steps:
                self._publishers[topic].publish(data)

    def _check_stall(self, now: float) -> None:
        if not self._stall_timeout:
            return
        if self._spec.on_stall is not None and (waited := self._behaviour.missing()) != self._waited:
            self._waited, self._waited_since = waited, now
        silence = self._repeater.silence(now)
        if silence < self._stall_timeout:
            return
        if not self._stalled:
            self._stalled = True
            step, missing = self._behaviour.missing()
            self._status.send("stalled", step=step, missing=missing[:20], count=len(missing), silence=round(silence, 1))
        if self._spec.on_stall is None or now - self._waited_since < self._stall_timeout:
            return
        answer = self._spec.on_stall()
        if answer:  # this completes a step: silence in the next one is a new stall
            self._progress(answer, now)

    def _progress(self, answer: Messages, now: float) -> None:
        """Publish an answer, which completes a step."""
        self._publish(answer)
        self._repeater.progress(now)
        if self._stalled:
            self._stalled = False
            self._status.send("recovered")
