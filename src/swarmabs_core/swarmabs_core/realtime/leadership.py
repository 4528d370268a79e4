"""Which one of a pair of coordinators speaks: its primary or its standby (docs/explanation/standby.md)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_core.declaration import same, setting
from swarmabs_core.events import EventCode
from swarmabs_core.messages import Messages, SwarmEvent
from swarmabs_core.pair_role import STANDBY_SUFFIX, PairRole, role_values
from swarmabs_core.realtime.base import MOST_BACK, Realtime

if TYPE_CHECKING:
    from swarmabs_core.realtime.base import Schedule

SINGLE, PRIMARY, STANDBY = "single", "primary", "standby"
TAKEOVER_STEPS = 2
"""Periods that a takeover takes beyond the silence after which it begins."""
AGREED = 10
"""Steps in a row in which a standby must hear the primary before it yields."""
PROMPT = 2
"""Largest age, in steps, of a message that was heard without delay, if the clocks agree."""
_LISTENS = {SINGLE: 0.0, PRIMARY: 1.0, STANDBY: 2.0}
"""Time, s, for which an instance that starts listens."""
SETTLES = 10
"""How many times as long as it listens an instance waits at its start until it can replace the other one."""
_NEVER = -(2**62)
_MOST_KEPT = 1000
"""Number of events that an instance keeps while nobody speaks."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Whether a coordinator has a standby or is one, and when the standby takes over."""

    rank: str = setting(
        SINGLE,
        "single: the only one of its kind; primary, standby: one of a pair of which one speaks",
        name="pair",
        choices=(SINGLE, PRIMARY, STANDBY),
    )
    paired: bool = setting(default=False, description="whether any coordinator of the fleet has a standby")
    takeover_after: float = same(Realtime, "takeover_after")

    @property
    def single(self) -> bool:
        """Whether this coordinator is the only one of its kind, and always speaks."""
        return self.rank == SINGLE

    def leadership(self, schedule: Schedule, clock_tolerance: float) -> Leadership:
        """Return the rules for this instance, given by how much clocks may differ (s)."""
        listening = schedule.steps(_LISTENS[self.rank])
        takeover = schedule.steps(self.takeover_after)
        return Leadership(self.rank, takeover, schedule.ahead(clock_tolerance), listening)


class Leadership:
    """Decides whether one of a pair of coordinators speaks. All times are steps.

    Call `hear` for every message of the other one, and `tick` once or more per step. A message of the other one that is
    at most `takeover` steps old shows that it speaks.

    1. An instance that starts listens for `listening` steps, and one that has missed more than `takeover` steps, which
       was stopped or whose clock was set, for `takeover` + 1, the standby for twice as long. It stands by as soon as it
       hears the other one, and leads if it does not.
    2. One that stands by leads as soon as it was able to speak for more than `takeover` steps in which the other one
       did not.
    3. If both speak, the standby yields once it has heard the primary without delay for `AGREED` steps in a row, as far
       as the clocks agree.
    4. A leader that was unable to speak for more than `takeover` steps yields when it hears the other one.

    Attributes
    ----------
    state : PairRole
        What it does.
    since : int
        Step since which it does so.
    why : str
        Why it does so.
    """

    def __init__(self, rank: str, takeover: int, ahead: int, listening: int) -> None:
        self._rank = rank
        self._takeover = takeover
        self._ahead = ahead
        self._prompt = min(PROMPT + ahead, takeover)
        self._starting = listening
        self.state = PairRole.LEADING if rank == SINGLE else PairRole.LISTENING
        self.since = 0
        self.why = ""
        self._until = 0
        self._last: int | None = None
        self._heard = self._able_since = self._able = self._spoke = _NEVER
        self._agreed = 0

    @property
    def leading(self) -> bool:
        """Whether it speaks in this step if it is able to."""
        return self.state is PairRole.LEADING

    def hear(self, message_step: int, step: int) -> None:
        """Note a message of the other one; one from the future shows nothing, because robots reject it too."""
        if message_step <= step + self._ahead:
            self._heard = max(self._heard, message_step)

    @property
    def heard(self) -> int:
        """The newest step in which the other one spoke."""
        return self._heard

    def hears_peer(self, step: int) -> bool:
        """Return whether the other one speaks."""
        return step - self._heard <= self._takeover

    def tick(self, step: int, *, able: bool = True) -> bool:
        """Return whether this instance speaks in a step; `able` if it has something to say."""
        if self._rank == SINGLE:
            return True
        before = self._last
        if before is not None and before - MOST_BACK <= step < before:
            step = before
        self._last = step
        if before is None:
            self._listen(step, self._starting, "started")
        elif not before <= step <= before + self._takeover:
            self._heard = self._heard if step > before else _NEVER
            self._spoke = self._able = _NEVER
            self._listen(step, self._pause, "was stopped, or its clock was set")
        if able and step != self._able:
            self._able_since = step if step - self._able > self._takeover else self._able_since
            self._able = step
        self._count(step, begins=step != before)
        self._decide(step, able=able)
        if self.leading and able:
            self._spoke = step
        return self.leading

    def release(self, step: int) -> None:
        """Hand over: listen until the other one speaks, and lead again before robots stop if it does not."""
        if self.leading and self._rank != SINGLE:
            self._heard = _NEVER
            self._listen(step, 2 * self._takeover, "released")

    def values(self, step: int, period: float) -> tuple[tuple[str, str], ...]:
        """Return the values for a health status, given the period (s); none for a coordinator without a peer."""
        if self._rank == SINGLE:
            return ()
        seconds = 0.0 if self._last is None else (step - self.since) * period
        peer = "not heard" if self._heard == _NEVER else f"heard {step - self._heard} steps ago"
        return *role_values(self._rank, self.state.value, seconds), ("peer", peer)

    @property
    def starting(self) -> int:
        """Steps for which it listens when it starts: in that time nodes discover each other."""
        return self._starting

    def settled_for(self, step: int) -> int:
        """Return for how many steps it has led or stood by, and heard what it needs to speak."""
        if self.state is PairRole.LISTENING or step - self._able > self._takeover:
            return 0
        return step - max(self.since, self._able_since)

    @property
    def _pause(self) -> int:
        """Steps to listen after a pause: the two differ, so that after a pause of both they do not begin at once."""
        return (self._takeover + 1) * (2 if self._rank == STANDBY else 1)

    def _listen(self, step: int, steps: int, why: str) -> None:
        self._become(PairRole.LISTENING, step, why)
        self._until = step + steps

    def _become(self, state: PairRole, step: int, why: str) -> None:
        self.state, self.since, self.why = state, step, why
        self._agreed = 0

    def _count(self, step: int, *, begins: bool) -> None:
        """Count the steps in a row in which the other one was heard without delay."""
        if not begins:
            return
        prompt = step - self._heard <= self._prompt
        self._agreed = min(self._agreed + 1, AGREED) if prompt else 0

    def _decide(self, step: int, *, able: bool) -> None:
        peer = self.hears_peer(step)
        if self.state is PairRole.LEADING:
            if peer and step - self._spoke > self._takeover:
                self._become(PairRole.FOLLOWING, step, "had nothing to say, and the peer speaks")
            elif self._rank == STANDBY and self._agreed >= AGREED:
                self._become(PairRole.FOLLOWING, step, "the primary speaks")
        elif peer:
            if self.state is PairRole.LISTENING:
                self._become(PairRole.FOLLOWING, step, "the peer speaks")
        elif self.state is PairRole.LISTENING:
            # Were both waiting for robots or the plane, the primary begins.
            patience = self._takeover + 1 if self._rank == STANDBY else 0
            if able and step >= max(self._until, self._able_since + patience):
                self._lead(step, "no peer speaks")
        elif able and step - max(self._heard, self._able_since - 1) > self._takeover:
            self._lead(step, "peer silent")

    def _lead(self, step: int, why: str) -> None:
        self._become(PairRole.LEADING, step, why)
        self._spoke = step


class Voice:
    """Passes on what one of a pair says while it leads, and tells that it has begun to, by events with a code.

    Events from the time in which neither spoke are published by the one that then leads.

    Attributes
    ----------
    leadership : Leadership
        The rules that decide whether it speaks.
    settled : bool
        Whether the other one may stop: this one has led or stood by, and could have spoken, for as long as it listens
        at its start. It is also set after `SETTLES` times as many steps, for then perhaps there is nothing to hear, and
        always for one without a peer.
    """

    def __init__(self, begun: EventCode, pair: Pair, schedule: Schedule, clock_tolerance: float) -> None:
        self.leadership = pair.leadership(schedule, clock_tolerance)
        self._schedule = schedule
        self._single = pair.single
        self._begun = begun
        self._suffix = STANDBY_SUFFIX if pair.rank == STANDBY else ""
        self._kept: deque[SwarmEvent] = deque(maxlen=_MOST_KEPT)
        self._leads = False
        self.settled = pair.single
        self._counted = 0
        self._step = _NEVER

    def release(self, now: int) -> Messages:
        """Hand over to the other one of the pair at a time (ns); say nothing."""
        self.leadership.release(self._schedule.step(now))
        return ()

    def values(self, now: int) -> tuple[tuple[str, str], ...]:
        """Return the values for a health status at a time (ns); none for a coordinator without a peer."""
        return self.leadership.values(self._schedule.step(now), self._schedule.period)

    def say(self, messages: Messages, now: int, *, able: bool = True) -> Messages:
        """Return what is published of the messages of a time (ns); `able` as for `Leadership.tick`."""
        if self._single:
            return messages
        step = self._schedule.step(now)
        speaks, led = self.leadership.tick(step, able=able), self._leads
        self._leads = speaks
        self._settle(step)
        if not speaks:
            self._kept.extend(message for message in messages if isinstance(message, SwarmEvent))
            while self._kept and self._kept[0].step <= self.leadership.heard:  # the other one has told it
                self._kept.popleft()
            return ()
        if led:
            return messages
        why = f"{self._suffix}: {self.leadership.why}"
        kept = (self._begun.event(now, max(0, step), why=why), *self._kept)
        self._kept.clear()
        return (*kept, *messages)

    def _settle(self, step: int) -> None:
        self._counted += step != self._step  # not their difference: the clock of a host that starts may be set
        self._step = step
        starting = self.leadership.starting
        if self.leadership.settled_for(step) >= starting or self._counted > SETTLES * starting:
            self.settled = True
