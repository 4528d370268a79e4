"""Which steps of a run a bag holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_bag.attached import SCENARIO_FILE
from swarmabs_bag.errors import DamagedBagError, NotABagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime import is_realtime
from swarmabs_config import configure
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.membership import Membership
from swarmabs_core.messages import AGENT_STATE, MAIN_TOPICS, AgentState, Status, SwarmEvent

if TYPE_CHECKING:
    from pathlib import Path

    from swarmabs_core.messages import Topic


@dataclass(frozen=True, slots=True)
class RecordedSteps:
    """How far a bag goes; where not even the first step is complete, the last one is that before it.

    Attributes
    ----------
    last_planned : int
        Last step of the scenario.
    first : int
        First complete step; not 0 in a later file of a split bag, or where the beginning is lost.
    last_complete : int
        Last step up to which, from the first one on, no message of a main topic is missing.
    by_topic : dict of str to int
        The same for each main topic, by its name with namespace.
    """

    last_planned: int
    first: int
    last_complete: int
    by_topic: dict[str, int]


def recorded_steps(path: Path | str) -> RecordedSteps | None:
    """Find out how far a bag goes; None if it is not the bag of one swarm with its scenario."""
    try:
        bag = open_bag(path, damaged=True)
        attached = bag.attachment(SCENARIO_FILE)
        # In real time a step need not have all messages.
        if attached is None or is_realtime(bag) or bag.contradicts_itself(SCENARIO_FILE):
            return None
        scenario = parse_scenario(attached.decode(), source=SCENARIO_FILE)
        members = configure.members(scenario)
        membership = Membership(members, configure.schedule(scenario))
        found: dict[tuple[Topic, int], _Spans] = {}
        for topic, _, message in bag.decoded():
            if isinstance(message, SwarmEvent):
                membership.apply(message.kind, message.agent_id, message.step, message.detail)
                continue
            agent = message.agent_id if isinstance(message, AgentState) else 0
            found.setdefault((topic, agent), _Spans()).add(message.step)
            if isinstance(message, AgentState) and message.status == Status.LEFT and agent in membership:
                membership.end(agent, message.step, stays=False, reason="left")
    except (NotABagError, DamagedBagError, InputError, UnicodeDecodeError):
        return None

    def first_missing(topic: Topic, start: int) -> int:
        missing = []
        for agent in members if topic is AGENT_STATE else (0,):
            begin, end = membership.span(agent) if agent else (0, None)
            last = scenario.steps if end is None else min(end, scenario.steps)
            step = found.get((topic, agent), _Spans()).first_missing(max(begin, start))
            missing.append(step if step <= last else scenario.steps + 1)
        return min(missing)

    # The file may begin within a step, which then is not the first.
    first = max((spans.first for (topic, _), spans in found.items() if topic is not AGENT_STATE), default=0)
    first += first_missing(AGENT_STATE, first) == first and first_missing(AGENT_STATE, first + 1) > first + 1
    last = {topic: first_missing(topic, first) - 1 for topic in MAIN_TOPICS}
    names = {channel.topic: channel.name for channel in bag.channels if channel.topic is not None}
    by_topic = {names[topic]: step for topic, step in last.items() if topic in names}
    return RecordedSteps(scenario.steps, first, min(last.values()), by_topic)


class _Spans:
    """A set of steps that come nearly in order, kept as spans."""

    def __init__(self) -> None:
        self._spans: list[tuple[int, int]] = []

    @property
    def first(self) -> int:
        return min((first for first, _ in self._spans), default=0)

    def add(self, step: int) -> None:
        first, last = self._spans[-1] if self._spans else (step, step)
        if self._spans and first <= step <= last + 1:
            self._spans[-1] = (first, max(last, step))
        else:
            self._spans.append((step, step))

    def first_missing(self, start: int) -> int:
        """Return the first step from `start` on that is not there."""
        position = start
        for first, end in sorted(self._spans):
            if first > position:
                break
            position = max(position, end + 1)
        return position
