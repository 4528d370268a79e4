# ruff: noqa: SLF001 - what a node holds is to be wrong
"""Faults of the kind that were once found late, to be planted in the product while a test runs.

Each is a mistake that somebody could make in one place. The search must find each of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from swarmabs_core.messages import DesiredAbstractState, Mode
from swarmabs_core.realtime import leadership
from swarmabs_core.realtime.agent import RealtimeAgent
from swarmabs_core.realtime.broadcasts import BroadcastInbox
from swarmabs_core.realtime.leadership import Leadership
from swarmabs_core.realtime.modes import ModeLatch, PublishedMode
from swarmabs_core.realtime.observer import RealtimeObserver, RealtimeSums, Role
from swarmabs_core.realtime.validation import Heard, HeardStates, Writers

Patch = pytest.MonkeyPatch


def stop_is_lost_in_a_takeover(patch: Patch) -> None:
    """A silent controller does not take over the STOP of the leader."""
    hear = PublishedMode.hear

    def hearing(self: PublishedMode, mode: Mode, step: int, *, leading: bool) -> None:
        if mode is Mode.STOP and not leading:
            return
        hear(self, mode, step, leading=leading)

    patch.setattr(PublishedMode, "hear", hearing)


def mixed_sets(patch: Patch) -> None:
    """A robot combines the sums of one observer with the other's abstract state."""

    def mixed(inbox: BroadcastInbox) -> Any:
        own = inbox._sets.get(inbox.followed)
        other = inbox._sets.get(inbox.followed._replace(observer=not inbox.followed.observer))
        if own is None or other is None or own.step != other.step:
            return own
        return own._replace(auxiliary=other.auxiliary)

    patch.setattr(BroadcastInbox, "newest", property(mixed))


def mixed_steps(patch: Patch) -> None:
    """A robot takes the desired state of a later step than the sums."""
    newest = BroadcastInbox.newest.fget  # type: ignore[attr-defined]

    def mixed(inbox: BroadcastInbox) -> Any:
        own = newest(inbox)
        heard = {} if own is None else inbox._heard.of(own.step + 1)
        later = [m for m in heard.values() if isinstance(m, DesiredAbstractState) and m.mode == Mode.RUN]
        return own._replace(desired=later[0]) if later and own.desired.mode == Mode.RUN else own

    patch.setattr(BroadcastInbox, "newest", property(mixed))


def old_broadcasts(patch: Patch) -> None:
    """A robot acts on broadcasts up to three times as old as it may."""
    problem = BroadcastInbox.problem

    def lenient(self: BroadcastInbox, now: int) -> str:
        self._age *= 3
        try:
            return problem(self, now)
        finally:
            self._age //= 3

    patch.setattr(BroadcastInbox, "problem", lenient)


def deaf_after_a_restart(patch: Patch) -> None:
    """A receiver that is bound to the first writer of an origin never accepts the next one."""
    refuses = Writers.refuses

    def forever(self: Writers, origin: Any, writer: bytes) -> bool:
        bound = self._bound.get(origin)
        return refuses(self, origin, writer) or (bound is not None and bool(writer) and writer != bound[0])

    patch.setattr(Writers, "refuses", forever)


def never_starts_again(patch: Patch) -> None:
    """An observer that restarts waits for a robot that died before, although the swarm is under way."""
    patch.setattr(RealtimeObserver, "_may_start", lambda self, step: self._known() >= self._needed)


def both_lead(patch: Patch) -> None:
    """A standby that leads does not yield to its primary."""
    patch.setattr(leadership, "AGREED", 10**9)


def nobody_takes_over(patch: Patch) -> None:
    """A standby that was stopped waits until it hears the other one."""
    decide = Leadership._decide

    def waiting(self: Leadership, step: int, *, able: bool) -> None:
        if self.state is leadership.PairRole.LISTENING and "stopped" in self.why and not self.hears_peer(step):
            return
        decide(self, step, able=able)

    patch.setattr(Leadership, "_decide", waiting)


def stop_is_not_latched(patch: Patch) -> None:
    """A robot stops while the newest broadcasts say STOP, and moves again as soon as they say RUN."""
    patch.setattr(ModeLatch, "stopped", property(lambda self: False))


def grows_with_forged_ids(patch: Patch) -> None:
    """What is heard is kept for ever."""
    add = Heard.add

    def keeping(self: Any, place: Any, message: Any, step: int, *, refused: bool = False) -> bool:
        self.__dict__.setdefault("kept", []).append(message)
        return add(self, place, message, step, refused=refused)

    patch.setattr(HeardStates, "add", keeping)


def impostor_is_believed(patch: Patch) -> None:
    """A second writer is refused, but what it says counts."""
    patch.setattr(Writers, "refuses", lambda self, origin, writer: False)


def silent_robots_still_count(patch: Patch) -> None:
    """The observer takes robots that have fallen silent for active for three times as long as it may."""
    role = RealtimeSums.role

    def late(self: RealtimeSums, state: Any, step: int) -> Role:
        return role(self, state, step if state is None or step - state.step > 3 * self._age else state.step)

    patch.setattr(RealtimeSums, "role", late)


def holds_through_a_clock_set_back(patch: Patch) -> None:
    """A robot whose clock is set back keeps what it has heard."""
    patch.setattr(BroadcastInbox, "forget", lambda self, now: None)
    patch.setattr(RealtimeAgent, "_doubt", lambda self, now: ())


def follows_a_stale_leader(patch: Patch) -> None:
    """A robot never leaves the coordinators that it has followed first."""
    patch.setattr(BroadcastInbox, "_choose", lambda self, step: None)


PLANTED: tuple[Callable[[Patch], None], ...] = (
    stop_is_lost_in_a_takeover,
    mixed_sets,
    mixed_steps,
    old_broadcasts,
    deaf_after_a_restart,
    never_starts_again,
    both_lead,
    nobody_takes_over,
    stop_is_not_latched,
    grows_with_forged_ids,
    impostor_is_believed,
    follows_a_stale_leader,
    holds_through_a_clock_set_back,
    silent_robots_still_count,
)
