"""Counting of refused messages: each reason is reported once, and again when it has not occurred for a while."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.messages import EventKind, SwarmEvent

if TYPE_CHECKING:
    from swarmabs_core.messages import Messages

QUIET_NS = 10_000_000_000
"""Time between two reports of the same reason, ns: an intruder must not flood the events."""
MOST_REASONS = 100
"""Reasons that are told apart; of more, only the number is kept."""


class Refusals:
    """Keeps the books on what a node has refused.

    Parameters
    ----------
    agent_id : int
        Robot that reports, 0 for none.

    Attributes
    ----------
    total : int
        Messages refused so far.
    latest : str
        The latest reason.
    """

    def __init__(self, agent_id: int = 0) -> None:
        self._agent_id = agent_id
        self._reported: dict[str, int] = {}
        self._since: dict[str, int] = {}
        self.total = 0
        self.latest = ""

    def add(self, reason: str, step: int, now: int) -> Messages:
        """Note a refusal and return the event, if it is to be reported; `reason` has few variants."""
        self.total += 1
        self.latest = reason
        if reason not in self._reported and len(self._reported) >= MOST_REASONS:
            return ()
        count = self._since.get(reason, 0) + 1
        last = self._reported.get(reason)
        if last is not None and now - last < QUIET_NS:
            self._since[reason] = count
            return ()
        self._reported[reason], self._since[reason] = now, 0
        return (SwarmEvent(now, max(0, step), self._agent_id, EventKind.REFUSED, float(count), reason),)
