"""When a robot concludes from silence that neighbours, or robots whose states the parent lacks, have ended."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swarmabs_core.behaviours.peer import Peer, Turn
    from swarmabs_core.messages import Messages


class Patience:
    """Watches for how long a robot has waited in a step, and what it has heard meanwhile.

    Who waits repeats what it has said, so a neighbour is silent of which not even that has been heard.

    Parameters
    ----------
    peer : Peer
        The robot.
    limit : float
        Silence, s, from which on it concludes: longer than the longest wait between repetitions.
    """

    def __init__(self, peer: Peer, limit: float) -> None:
        self._peer, self._limit = peer, limit
        self._turn: Turn | None = None
        self._begun = self._since = 0.0
        self._heard: dict[int, float] = {}

    def start_over(self, now: float) -> None:
        """Begin anew at a time, s, after a time in which the robot did not listen."""
        self._turn = None
        self._note(now)

    def look(self, now: float) -> Messages:
        """Tell the robot what follows from silence up to a time, s, on any clock; return what it publishes.

        Raises
        ------
        RunError
            As for `Peer.stalled`.
        """
        peer = self._peer
        self._note(now)
        since = now - self._limit
        if self._begun > since:
            return ()
        silent = [robot for robot in peer.neighbours if self._heard.get(robot, self._begun) <= since]
        return peer.stalled(silent, waited=self._since <= since)

    def _note(self, now: float) -> None:
        self._heard.update(dict.fromkeys(self._peer.take_heard(), now))
        turn, before = self._peer.turn, self._turn
        if before is None or turn.step != before.step:
            self._begun = now
        if turn != before:
            self._since = now
        self._turn = turn
