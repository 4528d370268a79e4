"""What a bag in real time holds around a step, whatever the order in which it was received."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from swarmabs_bag.realtime_recording import MEMORY, conflict
from swarmabs_core.messages import (
    AGENT_STATE,
    BASIS,
    DESIRED_ABSTRACT_STATE,
    AgentState,
    Basis,
    DesiredAbstractState,
    Mode,
    Source,
    SwarmEvent,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_core.messages import Topic
    from swarmabs_core.record import Record

WAIT = 300
"""Steps that a message may be received behind those of later steps, and is still judged in its place."""
_KEPT = MEMORY + 2 * WAIT


class History:
    """Messages by topic, step and what else tells them apart, of as many steps as may matter."""

    def __init__(self) -> None:
        self._by_step: dict[Topic, dict[int, dict[int, Record]]] = defaultdict(dict)
        self._robots: dict[int, dict[int, Record]] = defaultdict(dict)
        self._pinned: dict[int, dict[tuple[int, int], Record]] = {}
        self._ambiguous: set[tuple[str, int, int]] = set()
        self._newest: dict[tuple[str, int], int] = {}
        self.steps: set[int] = set()
        self._oldest = 0

    def add(self, stored: Record) -> bool:
        """Keep a message; return whether there is none in its place yet."""
        message, topic = stored.message, stored.topic
        if isinstance(message, SwarmEvent):
            of = conflict(message)
            if of is not None:
                self._ambiguous.add((of, message.agent_id, message.step))
            return True
        sender = 0
        if isinstance(message, AgentState):
            place, key = self._robots[message.agent_id], message.step
            sender = message.agent_id
        else:
            place = self._by_step[topic].setdefault(message.step, {})
            key = 0
            if isinstance(message, Basis):
                key = sender = message.source
            elif isinstance(message, DesiredAbstractState):
                key = message.mode
        if key in place:
            return False
        place[key] = stored
        if message.step < self._newest.get((topic.name, sender), -1):
            # A sender's messages keep their order. Its clock may have been set back, and this not be the first.
            self._ambiguous.add((topic.name, sender, message.step))
        else:
            self._newest[topic.name, sender] = message.step
        self.steps.add(message.step)
        return True

    def forget(self, step: int) -> None:
        """Forget what is too old to matter for steps from this one on; what a coordinator still uses is kept."""
        for robot in self._robots.values():
            while len(robot) > _KEPT:
                del robot[next(iter(robot))]
        oldest, first = step - _KEPT, self._oldest
        if oldest - first > len(self.steps):
            for by_step in self._by_step.values():
                for old in [s for s in by_step if s < oldest]:
                    del by_step[old]
            self.steps = {s for s in self.steps if s >= oldest}
        else:
            for old in range(first, oldest):
                for by_step in self._by_step.values():
                    by_step.pop(old, None)
                self.steps.discard(old)
        self._oldest = max(first, oldest)

    def get(self, topic: Topic, step: int, key: int = 0) -> Record | None:
        """Return the message of a coordinator."""
        return self._by_step[topic].get(step, {}).get(key)

    def basis(self, source: Source, step: int) -> Basis | None:
        """Return from what a coordinator has computed its answer of a step."""
        stored = None if self.is_ambiguous(BASIS, step, source) else self.get(BASIS, step, source)
        message = None if stored is None else stored.message
        return message if isinstance(message, Basis) else None

    def desired(self, step: int) -> list[Record]:
        """Return the desired states of a step: one of each mode, RUN first."""
        found = self._by_step[DESIRED_ABSTRACT_STATE].get(step, {})
        return [found[mode] for mode in sorted(found)]

    def changes_within(self, step: int) -> bool:
        """Tell whether the parent controller may have changed its mind within a step that has no RUN."""
        before = next((found for s in range(step - 1, step - WAIT, -1) if (found := self.desired(s))), None)
        return before is None or any(getattr(stored.message, "mode", None) == Mode.RUN for stored in before)

    def robots(self) -> list[int]:
        """Return the ids of all robots that have been heard."""
        return sorted(self._robots)

    def state(self, agent_id: int, step: int) -> Record | None:
        """Return the state of a robot."""
        found = self._robots[agent_id].get(step) if agent_id in self._robots else None
        if found is not None:
            return found
        return next((pins[agent_id, step] for pins in self._pinned.values() if (agent_id, step) in pins), None)

    def states(self, source: Source, basis: Basis) -> dict[int, AgentState] | str:
        """Return the states that a coordinator says to have used, or why they are not all there; they are kept."""
        pins, found = {}, {}
        problem = ""
        for agent_id, step in zip(basis.agent_ids, basis.state_steps, strict=True):
            stored = self.state(agent_id, step)
            if stored is None:
                problem = NO_STATES
                continue
            if self.is_ambiguous(AGENT_STATE, step, agent_id):
                problem = AMBIGUOUS
            pins[agent_id, step] = stored
            assert isinstance(stored.message, AgentState)  # noqa: S101 - kept as such
            found[agent_id] = stored.message
        self._pinned[source] = pins
        return problem or found

    def is_ambiguous(self, topic: Topic, step: int, agent_id: int = 0) -> bool:
        """Tell whether different messages were received of which the bag has the first."""
        return (topic.name, agent_id, step) in self._ambiguous

    def any_ambiguous(self, topics: Iterable[Topic], step: int) -> bool:
        """Tell whether a coordinator's messages of a step are ambiguous."""
        return any(self.is_ambiguous(topic, step) for topic in topics)


AMBIGUOUS = "different messages of the step may have been sent, of which the bag has one"
NO_STATES = "a robot's state that it was computed from is not in the bag"
