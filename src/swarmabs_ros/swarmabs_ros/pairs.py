"""Pairs of coordinators in lockstep: a primary, and a standby that computes the same and stays silent.

Both hear the same messages, so both compute the same bits, and each may publish at any time: receivers ignore what they
already have. The standby publishes what its primary has not published in time, as any node repeats itself. Each step,
both publish one message on the same topic; what arrives there beyond the own messages tells how far the other one is.
"""

from __future__ import annotations

from collections import Counter, deque
from typing import TYPE_CHECKING

from swarmabs_core.cdr import step_of
from swarmabs_core.errors import RunError
from swarmabs_core.messages import RECORDING_PROGRESS

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.messages import Topic

SIGNS = 10
"""Signs of life of a silent standby per window of steps by which the run may be ahead of it."""
MOST_EARLY = 128
"""How many steps a message may be ahead of a coordinator that has a peer: what the others repeat at most."""
_REMEMBERED = 1000
"""Number of own messages whose return is expected."""


class BehindError(RunError):
    """One of a pair has missed messages that nobody repeats: its peer continues alone."""

    def __init__(self, step: int, newest: int) -> None:
        super().__init__(f"fell behind: the swarm is at step {newest}, and this node still at step {step}")


class OwnMessages:
    """Recognizes own messages on a topic that a node both publishes and reads: each comes back once."""

    def __init__(self) -> None:
        self._expected = Counter[bytes]()
        self._order = deque[bytes]()

    def published(self, data: bytes) -> None:
        """Expect the return of a message."""
        self._expected[data] += 1
        self._order.append(data)
        if len(self._order) > _REMEMBERED:  # one that was lost on the way is not expected for ever
            self._forget(self._order.popleft())

    def returned(self, data: bytes) -> bool:
        """Return whether a message that has arrived is an own one."""
        found = self._expected[data] > 0
        self._forget(data)
        return found

    def _forget(self, data: bytes) -> None:
        self._expected[data] -= 1
        if self._expected[data] <= 0:
            del self._expected[data]


class _FarAhead:
    """Tells where a swarm is by messages of steps far ahead: one may be a stray one, so a second has to confirm it."""

    def __init__(self) -> None:
        self._step: int | None = None

    def confirmed(self, step: int) -> bool:
        """Return whether the last message was of another step, close to this one."""
        known, self._step = self._step, step
        return known is not None and 0 < abs(known - step) <= MOST_EARLY


class LockstepLeadership:
    """What one of a pair knows of the other one, and whether it publishes.

    The run is never ahead of a living peer by more than a window of steps: whatever one of the two has missed is
    repeated then. One for which the other has waited in vain is lost, until it is heard again.

    Parameters
    ----------
    topic : Topic
        The topic on which both publish one message per step.
    current : callable
        Returns the step for which this one waits.
    standby : bool
        Whether this one is the standby.
    window : int
        How many steps the run may be ahead of one of them.
    patience : float
        How long one waits for the other, s; longer than the others need to repeat themselves.

    Attributes
    ----------
    leading : bool
        Whether it publishes all its messages.
    step : int
        The newest step that it has computed, -1 before the first.
    """

    def __init__(
        self, topic: Topic, current: Callable[[], int], *, standby: bool, window: int, patience: float
    ) -> None:
        self.topic = topic
        self.current = current
        self.leading = not standby
        self.step = -1
        self._standby = standby
        self._window, self._every = window, max(1, window // SIGNS)
        self._patience = patience
        self._peer, self._far = -1, _FarAhead()
        self._waiting_since: float | None = None
        self._lost = self._ended = False

    def publishes(self, topic: Topic, step: int) -> bool:
        """Return whether a new message is published; while silent, the standby only shows that it lives."""
        if topic is self.topic:
            self.step = max(self.step, step)
        return self.leading or (topic is self.topic and step % self._every == 0)

    def hear(self, step: int) -> None:
        """Take the step of a message of the peer; a standby falls silent when its primary is as far as itself."""
        if step > self.step + MOST_EARLY and not self._far.confirmed(step):
            return
        self._peer = max(self._peer, step)
        if step >= self.step - self._window:
            self._lost = False
        if self._standby and self._peer >= self.step:
            self.leading = False

    def take_over(self) -> bool:
        """Lead from now on, if the swarm waits for a message that the primary has not published; return whether."""
        if self.leading or self._peer >= self.step:
            return False
        self.leading = True
        return True

    def waits(self, now: float) -> bool:
        """Return whether to wait for the peer at a time, s, before the next step."""
        if self._ended or self._lost or self.step - self._peer <= self._window:
            self._waiting_since = None
            return False
        if self._waiting_since is None:
            self._waiting_since = now
        self._lost = now - self._waiting_since >= self._patience
        return not self._lost

    def peer_ended(self) -> None:
        """Wait for the peer no more: its process has ended."""
        self._ended = True


class EarlyMessages:
    """Serialized messages of later steps than that of a node, kept until it is there: its peer may be ahead."""

    def __init__(self) -> None:
        self._kept: dict[int, deque[tuple[Topic, bytes]]] = {}
        self._far = _FarAhead()

    def keep(self, topic: Topic, data: bytes, step: int) -> bool:
        """Keep a message if it is of a later step than the current one; return whether it is.

        One that is so late that the messages before it will not be repeated is not kept.

        Raises
        ------
        BehindError
            If the swarm is so far ahead.
        MalformedMessageError
            If it is not a message of this swarm.
        """
        ahead = 0 if topic is RECORDING_PROGRESS else step_of(data, topic.type_name) - step
        if ahead > MOST_EARLY:
            if self._far.confirmed(step + ahead):
                raise BehindError(step, step + ahead)
            return True
        if ahead > 0:
            self._kept.setdefault(step + ahead, deque()).append((topic, data))
        return ahead > 0

    def take(self, step: int) -> tuple[Topic, bytes] | None:
        """Return a message of the current step, None if there is none left."""
        for old in [each for each in self._kept if each < step]:
            del self._kept[old]
        kept = self._kept.get(step)
        return kept.popleft() if kept else None
