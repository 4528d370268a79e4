"""The loop that drives a node behaviour in lockstep over DDS."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import TOPIC_OF
from swarmabs_ros.repeat import FIRST, WINDOW, Repeater

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.publisher import Publisher

    from swarmabs_core.behaviours import Behaviour
    from swarmabs_core.messages import Messages, Topic
    from swarmabs_ros.endpoints import Receiver
    from swarmabs_ros.status import StatusChannel

SLICE = 0.1
"""Longest time, s, for which a node does not look whether it shall stop."""


class Lockstep:
    """Takes what the behaviour awaits, publishes what it answers, repeats itself when nothing comes.

    Parameters
    ----------
    behaviour : Behaviour
        The node's state machine.
    receiver : Receiver
        Its subscriptions.
    publishers : mapping
        Its publishers by topic.
    status : StatusChannel
        Where stalls are reported.
    stall_timeout : float
        Silence, s, that counts as a stall; 0 for never.
    on_stall : callable, optional
        What the behaviour answers to a stall, such as dropping robots. It is asked as long as the stall lasts, once
        it has been waited for the same for `stall_timeout`.
    lingers : bool
        Whether to go on repeating the last messages when the behaviour has finished.
    gather : float
        Time, s, for which messages may gather once the first has come, before they are handled.
    repeat_after : float
        Shortest wait before a repetition, s.
    repeat_steps : int
        Most steps that are repeated.
    on_idle : callable, optional
        Called whenever nothing more has arrived, every `SLICE` s at the latest.
    hear : callable, optional
        Takes a message for the behaviour by topic and bytes; by default they are decoded for `Behaviour.handle`.
    """

    def __init__(
        self,
        behaviour: Behaviour,
        receiver: Receiver,
        publishers: Mapping[Topic, Publisher],
        status: StatusChannel,
        *,
        stall_timeout: float,
        on_stall: Callable[[], Messages] | None = None,
        lingers: bool = True,
        gather: float = 0.0,
        repeat_after: float = FIRST,
        repeat_steps: int = WINDOW,
        on_idle: Callable[[], None] | None = None,
        hear: Callable[[Topic, bytes], Messages] | None = None,
    ) -> None:
        self._behaviour = behaviour
        self._receiver = receiver
        self._publishers = publishers
        self._status = status
        self._stall_timeout = stall_timeout
        self._on_stall = on_stall
        self._lingers = lingers
        self._gather = gather
        self._repeat_after = repeat_after
        self._repeat_steps = repeat_steps
        self._on_idle = on_idle
        self._hear = hear or self._decoded
        self._sent: deque[tuple[int, Publisher, bytes]] = deque()
        self._stalled = False
        self._waited: tuple[int, tuple[str, ...]] = (-1, ())
        self._waited_since = 0.0
        self._stopping = False

    def stop(self) -> None:
        """Make `run` return soon."""
        self._stopping = True

    def run(self) -> None:
        """Drive the behaviour until `stop` is called, or until it has finished if it does not linger.

        A lingering behaviour that has finished goes on repeating its last messages, in case somebody still lacks one.

        Raises
        ------
        RunError
            If the behaviour refuses to go on.
        """
        behaviour, receiver = self._behaviour, self._receiver
        repeater = Repeater(time.monotonic(), first=self._repeat_after, most=self._repeat_steps)
        self._publish(behaviour.start())
        while not self._stopping:
            topics = behaviour.awaits()
            if not topics and not self._lingers:
                return
            if self._drain(topics, repeater):
                continue
            if self._on_idle is not None:
                self._on_idle()
            now = time.monotonic()
            if topics:
                if receiver.wait(topics, min(SLICE, repeater.wait(now))):
                    if self._gather:
                        time.sleep(self._gather)
                    continue
                now = time.monotonic()
                self._check_stall(repeater, now)
            else:
                time.sleep(min(SLICE, repeater.wait(now)))
                now = time.monotonic()
            self._repeat(repeater.due(now))

    def _drain(self, topics: tuple[Topic, ...], repeater: Repeater) -> bool:
        """Handle what has arrived on these topics, as long as they are what is awaited; tell whether there was any."""
        behaviour, take = self._behaviour, self._receiver.take
        found = False
        for topic in topics:
            while (data := take(topic)) is not None:
                found = True
                answer = self._hear(topic, data)
                if answer:
                    self._publish(answer)
                    repeater.progress(time.monotonic())
                    self._recovered()
                if behaviour.awaits() != topics:
                    return True
        return found

    def _decoded(self, topic: Topic, data: bytes) -> Messages:
        return self._behaviour.handle(decode(topic.message, data))

    def _publish(self, messages: Messages) -> None:
        for message in messages:
            publisher = self._publishers[TOPIC_OF[type(message)]]
            data = encode(message)
            publisher.publish(data)
            self._sent.append((message.step, publisher, data))
        if self._sent:
            oldest = self._sent[-1][0] - WINDOW
            while self._sent[0][0] < oldest:
                self._sent.popleft()

    def _repeat(self, steps: int) -> None:
        if not steps or not self._sent:
            return
        newest = self._sent[-1][0]
        for step, publisher, data in self._sent:
            if step > newest - steps:
                publisher.publish(data)

    def _check_stall(self, repeater: Repeater, now: float) -> None:
        if not self._stall_timeout:
            return
        if self._on_stall is not None and (waited := self._behaviour.missing()) != self._waited:
            self._waited, self._waited_since = waited, now
        silence = repeater.silence(now)
        if silence < self._stall_timeout:
            return
        if not self._stalled:
            self._stalled = True
            step, missing = self._behaviour.missing()
            self._status.send("stalled", step=step, missing=missing[:20], count=len(missing), silence=round(silence, 1))
        if self._on_stall is None or now - self._waited_since < self._stall_timeout:
            return
        answer = self._on_stall()
        if answer:  # a step is made: whoever is silent in the next one is another stall
            self._publish(answer)
            repeater.progress(now)
            self._recovered()

    def _recovered(self) -> None:
        if self._stalled:
            self._stalled = False
            self._status.send("recovered")
