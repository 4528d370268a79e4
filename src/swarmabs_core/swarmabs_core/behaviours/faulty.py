"""A robot with injected faults: what it says and hears besides what it makes of the broadcasts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.behaviours.agent import Agent
from swarmabs_core.messages import AgentState, EventKind, SwarmEvent

if TYPE_CHECKING:
    from swarmabs_core.behaviours.agent import AgentConfig
    from swarmabs_core.behaviours.packing import Listener
    from swarmabs_core.faults import RobotFaults
    from swarmabs_core.messages import Message, Messages, Topic


class FaultyAgent:
    """Announces a robot's faults; duplicates messages, shifts stamps, falsifies states. The robot in it knows nothing.

    Loss, delay and reordering of the broadcasts are in the robot itself: they decide what it acts on.

    Parameters
    ----------
    robot : Listener
        The robot.
    config : AgentConfig
        Its configuration.

    Attributes
    ----------
    needs : tuple of Topic
        The topics to which it listens.
    """

    def __init__(self, robot: Listener, config: AgentConfig) -> None:
        self._robot = robot
        self._faults: RobotFaults = config.injected()
        self._agent_id = config.agent_id
        self._there = False
        self.needs: tuple[Topic, ...] = robot.needs

    def start(self) -> Messages:
        """Start the robot."""
        return self._as_said(self._robot.start())

    def handle(self, message: Message) -> Messages:
        """Hand a broadcast to the robot, now and then twice."""
        answers = self._as_said(self._robot.handle(message))
        if self._faults.hears_twice(message.step):
            answers = (*answers, *self._as_said(self._robot.handle(message)))
        return answers

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for what the robot waits for."""
        return self._robot.awaits()

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the current step and the topics not yet heard."""
        return self._robot.missing()

    def _as_said(self, answers: Messages) -> Messages:
        """Return what is published instead of the robot's answers."""
        said: list[Message] = []
        for answer in answers:
            if isinstance(answer, AgentState):
                said.extend(self._announced(answer))
                said.extend([self._faults.said(answer)] * (2 if self._faults.says_twice(answer.step) else 1))
            else:
                said.append(answer)
        return tuple(m._replace(stamp=m.stamp + self._faults.clock_offset(m.step)) for m in said)

    def _announced(self, state: AgentState) -> list[SwarmEvent]:
        """Return the events of the faults that begin or end with a state; with the first, of all that act."""
        found = self._faults.changing(state.step) if self._there else self._faults.acting(state.step)
        self._there = True
        kind = EventKind.FAULT_INJECTED
        return [SwarmEvent(state.stamp, state.step, self._agent_id, kind, value, text) for value, text in found]


def with_faults(robot: Listener, config: AgentConfig) -> Listener:
    """Return a robot with what is injected into it; the robot itself if that is nothing."""
    return FaultyAgent(robot, config) if config.faults else robot


def make_agent(config: AgentConfig) -> Listener:
    """Return the state machine of a robot, with what is injected into it."""
    return with_faults(Agent(config), config)
