"""Gathering of the robots' states of one step: what observer and plane have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import StepAheadError, UnknownAgentError, refuse_conflict
from swarmabs_core.messages import Status

if TYPE_CHECKING:
    from swarmabs_core.membership import Membership
    from swarmabs_core.messages import AgentState


class Gathering:
    """Collects the states of one step until every member's is there.

    Parameters
    ----------
    membership : Membership
        Says whose state is waited for; it learns of robots that say that they leave.
    """

    def __init__(self, membership: Membership) -> None:
        self._membership = membership
        self._step = 0
        self._states: dict[int, AgentState] = {}

    @property
    def step(self) -> int:
        """The step that is gathered."""
        return self._step

    def add(self, state: AgentState) -> None:
        """Take a state; late and repeated ones change nothing.

        Raises
        ------
        UnknownAgentError
            If the robot is not a member.
        StepAheadError
            If its step cannot have begun yet.
        ConflictError
            If it differs from one that is already there.
        """
        agent_id, step = state.agent_id, state.step
        if not self._membership.publishes(agent_id, step):
            if agent_id not in self._membership:
                raise UnknownAgentError(agent_id)
            return
        if step != self._step:
            if step > self._step:
                raise StepAheadError(f"agent {agent_id}", got=step, expected=self._step)
            return
        known = self._states.get(agent_id)
        if known is not None:
            refuse_conflict(known, state, f"agent {agent_id}")
            return
        self._states[agent_id] = state
        if state.status == Status.LEFT:
            self._membership.end(agent_id, step, stays=False, reason="left")

    def complete(self) -> bool:
        """Tell whether every member's state is there."""
        members = self._membership.publishing(self._step)
        states = self._states
        return len(states) >= len(members) and all(agent_id in states for agent_id in members)

    def missing(self) -> tuple[int, ...]:
        """Return the ids of the members whose state is missing."""
        return tuple(i for i in self._membership.publishing(self._step) if i not in self._states)

    def take(self) -> list[AgentState]:
        """Return the states of the complete step by ascending id, and turn to the next step."""
        states = [self._states[i] for i in self._membership.publishing(self._step)]
        self._step += 1
        self._states = {}
        return states
