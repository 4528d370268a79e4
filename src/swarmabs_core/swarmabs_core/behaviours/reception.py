"""The broadcasts that reach a robot and the messages that it publishes, under injected faults."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.events import EventCode
from swarmabs_core.faults import RobotFaults
from swarmabs_core.messages import (
    ROBOT_STATES,
    AnyBroadcast,
    Message,
    Messages,
    Mode,
    SwarmEvent,
)

if TYPE_CHECKING:
    from swarmabs_core.messages import AnyRobotState


class Reception:
    """Complete sets of broadcasts in transit to a robot, and the newest that has arrived.

    Attributes
    ----------
    newest : Broadcast, SwarmBroadcast or None
        The newest set that has arrived.
    """

    def __init__(self, faults: RobotFaults | None) -> None:
        self._faults = faults
        self._coming: dict[int, list[AnyBroadcast]] = {}
        self._stop_at = self._reset_at = -1
        self.newest: AnyBroadcast | None = None

    def send(self, step: int, broadcasts: AnyBroadcast) -> bool:
        """Send the set of the current step; return whether the robot receives anything in this step."""
        come = [broadcasts]
        if self._faults is not None:
            acting, draw = self._faults.acting(step), self._faults.draw(step)
            self._coming.setdefault(step + sum(fault.late(draw) for fault in acting), []).append(broadcasts)
            come = self._coming.pop(step, [])
            if any(fault.loses(draw) for fault in acting):
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
        """Whether a set that has arrived commands a stop, and no later one a reset."""
        return self._stop_at > self._reset_at


class Transmission:
    """Announces a robot's faults, duplicates its messages, shifts their stamps, falsifies its states."""

    def __init__(self, faults: RobotFaults | None) -> None:
        self._faults = faults
        self._begun = False

    def published(self, answers: Messages) -> Messages:
        """Return the messages that are published instead of the robot's own."""
        faults = self._faults
        if faults is None:
            return answers
        said: list[Message] = []
        for answer in answers:
            if isinstance(answer, ROBOT_STATES):
                said.extend(self._announced(faults, answer))
                state = answer
                for fault in faults.acting(answer.step):
                    state = fault.falsified(state)
                said.extend([state] * (2 if faults.double(answer.step, "state") else 1))
            else:
                said.append(answer)
        return tuple(m._replace(stamp=m.stamp + sum(f.clock_offset() for f in faults.acting(m.step))) for m in said)

    def _announced(self, faults: RobotFaults, state: AnyRobotState) -> list[SwarmEvent]:
        """Return events for the faults that start or end with a state; with the first state, for all that act."""
        announced = faults.announced(state.step, first=not self._begun)
        self._begun = True
        tell = EventCode.FAULT_INJECTED.event
        return [tell(state.stamp, state.step, value, robot=state.agent_id, detail=text) for value, text in announced]
