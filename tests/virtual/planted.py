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


def silent_robots_still_count(patch: Patch) -> None:
    """The observer takes robots that have fallen silent for active for three times as long as it may."""
    role = RealtimeSums.role

    def late(self: RealtimeSums, state: Any, step: int) -> Role:
        return role(self, state, step if state is None or step - state.step > 3 * self._age else state.step)

    patch.setattr(RealtimeSums, "role", late)


def grows_with_forged_ids(patch: Patch) -> None:
    """What is heard is kept for ever."""
    add = Heard.add

    def keeping(self: Any, place: Any, message: Any, step: int, *, refused: bool = False) -> bool:
        self.__dict__.setdefault("kept", []).append(message)
        return add(self, place, message, step, refused=refused)

    patch.setattr(HeardStates, "add", keeping)


def older_states_win(patch: Patch) -> None:
    """The observer takes the state that arrives last for the newest."""
    hear = RealtimeObserver.hear

    def hearing(self: RealtimeObserver, message: Any, now: int, sender: Any) -> Any:
        answer = hear(self, message, now, sender)
        if type(message).__name__ == "AgentState" and not answer and message.agent_id in self.roles:
            self._states[message.agent_id] = message
            self._steps[message.agent_id] = message.step
        return answer

    patch.setattr(RealtimeObserver, "hear", hearing)


def holds_through_a_clock_set_back(patch: Patch) -> None:
    """A robot whose clock is set back keeps what it has heard."""
    patch.setattr(BroadcastInbox, "forget", lambda self, now: None)
    patch.setattr(RealtimeAgent, "_doubt", lambda self, now: ())


def leads_although_cut_off(patch: Patch) -> None:
    """An observer that hears no robot leads."""
    patch.setattr(RealtimeObserver, "_hears_robots", property(lambda self: True))


def release_is_forgotten(patch: Patch) -> None:
    """A coordinator that is released never leads again if the other one is gone."""
    patch.setattr(leadership, "_LISTENS", {**leadership._LISTENS})
    listen = Leadership._listen

    def patient(self: Leadership, step: int, steps: int, why: str) -> None:
        listen(self, step, 10**9 if why == "released" else steps, why)

    patch.setattr(Leadership, "_listen", patient)


def follows_a_stale_leader(patch: Patch) -> None:
    """A robot never leaves the coordinators that it has followed first."""
    patch.setattr(BroadcastInbox, "_choose", lambda self, step: None)


def stop_of_the_silent_controller(patch: Patch) -> None:
    """A STOP that an operator gives to the silent controller is not passed on."""
    patch.setattr(PublishedMode, "told_to_stop", property(lambda self: False))


def impostor_is_believed(patch: Patch) -> None:
    """A second writer is refused, but what it says counts."""
    patch.setattr(Writers, "refuses", lambda self, origin, writer: False)


def counts_who_has_left(patch: Patch) -> None:
    """A robot that has left counts as silent when its last state is old."""
    role = RealtimeSums.role

    def forgetting(self: RealtimeSums, state: Any, step: int) -> Role:
        found = role(self, state, step)
        return Role.SILENT if found is Role.LEFT and step - state.step > 5 * self._age else found

    patch.setattr(RealtimeSums, "role", forgetting)


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
    silent_robots_still_count,
    grows_with_forged_ids,
    older_states_win,
    holds_through_a_clock_set_back,
    leads_although_cut_off,
    release_is_forgotten,
    follows_a_stale_leader,
    stop_of_the_silent_controller,
    impostor_is_believed,
    counts_who_has_left,
)
