"""What a robot has of the broadcasts when they do not come as they were sent."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.messages import Mode

if TYPE_CHECKING:
    from swarmabs_core.faults import RobotFaults
    from swarmabs_core.messages import Broadcast


class Inbox:
    """Complete sets on their way to a robot, and the newest that has come.

    Parameters
    ----------
    faults : RobotFaults
        What becomes of them on the way.

    Attributes
    ----------
    newest : Broadcast or None
        The newest set that has come.
    """

    def __init__(self, faults: RobotFaults) -> None:
        self._faults = faults
        self._coming: dict[int, list[Broadcast]] = {}
        self._stop_at = self._reset_at = -1
        self.newest: Broadcast | None = None

    def send(self, step: int, broadcasts: Broadcast) -> bool:
        """Send the set of the current step; tell whether the robot hears in this step at all."""
        self._coming.setdefault(step + self._faults.late(step), []).append(broadcasts)
        come = self._coming.pop(step, [])
        if self._faults.loses(step):
            return False
        for sent in come:
            sent_at, mode = sent.step, sent.desired.mode
            if mode == Mode.RESET:
                self._reset_at = max(self._reset_at, sent_at)
            elif mode != Mode.RUN:
                self._stop_at = max(self._stop_at, sent_at)
            if self.newest is None or sent_at > self.newest.step:
                self.newest = sent
        return True

    @property
    def stopped(self) -> bool:
        """Whether a set that has come asks for a stop, and no later one for its end."""
        return self._stop_at > self._reset_at
