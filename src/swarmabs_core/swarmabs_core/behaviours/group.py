"""Several robots in one process, for swarms larger than a machine has room for processes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.behaviours.steered import make_newcomer
from swarmabs_core.messages import TOPIC_OF

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.behaviours.agent import AgentConfig
    from swarmabs_core.messages import Message, Messages, Topic


class AgentGroup:
    """Robots that share subscriptions and nothing else: each is its own state machine and hears the broadcasts alone.

    Parameters
    ----------
    configs : sequence of AgentConfig
        Configurations of the robots.
    steered : bool
        Whether the run is steered, so that robots may be added.

    Attributes
    ----------
    needs : tuple of Topic
        The topics to which the robots listen.
    """

    def __init__(self, configs: Sequence[AgentConfig], *, steered: bool = False) -> None:
        self._agents = [make_newcomer(config, steered=steered) for config in configs]
        self.needs = tuple(dict.fromkeys(topic for agent in self._agents for topic in agent.needs))
        self._listeners = {topic: [a for a in self._agents if topic in a.needs] for topic in self.needs}

    def start(self) -> Messages:
        """Publish the initial states of the robots that are there from the beginning."""
        return tuple(message for agent in self._agents for message in agent.start())

    def handle(self, message: Message) -> Messages:
        """Hand a broadcast to every robot; with the last one of the step answer their next states."""
        listeners = self._listeners[TOPIC_OF[type(message)]]
        return tuple(answer for agent in listeners for answer in agent.handle(message))

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for whatever a robot waits for; empty when all have finished."""
        return tuple(dict.fromkeys(topic for agent in self._agents for topic in agent.awaits()))

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the first step that a robot waits in, and what is missing for it."""
        return min((agent.missing() for agent in self._agents if agent.awaits()), default=self._agents[0].missing())
