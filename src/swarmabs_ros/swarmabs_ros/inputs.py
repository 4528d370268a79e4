"""The messages that have arrived at a node in lockstep, to notice two different ones where there can be only one.

A node acts on the first message in each place and ignores repetitions, so a second publisher, such as another swarm in
the namespace, could make it act on the wrong one. Every later message is therefore compared with the first, also after
the node has used it.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from swarmabs_core.behaviours.base import ConflictError
from swarmabs_core.cdr import canonical, places, step_of
from swarmabs_core.messages import EVENTS, RECORDING_PROGRESS, STEERING

if TYPE_CHECKING:
    from swarmabs_core.messages import Topic

SEVERAL = (EVENTS, RECORDING_PROGRESS)
"""Topics with any number of messages per step."""


@cache
def _place_in_step(topic: Topic) -> slice:
    """Return where messages of a topic have robot and round, whose place they take; empty if a step has one message."""
    if topic is STEERING:  # a step has one order, whichever robot it names
        return slice(0)
    offset, ends = 0, {}
    for place in places(topic.message):
        ends[place.name] = offset, offset + place.size
        offset += place.size
    if "agent_id" not in ends:
        return slice(0)
    first, end = ends["agent_id"]
    return slice(first, ends.get("round", (0, end))[1])


class Inputs:
    """The first message in each place, that is of each topic, step, robot and round, of the latest steps.

    Parameters
    ----------
    steps : int
        Number of steps that are kept: more than others repeat.
    """

    def __init__(self, steps: int) -> None:
        self._most = steps
        self._steps: dict[int, dict[tuple[Topic, bytes], bytes]] = {}

    def compare(self, topic: Topic, data: bytes) -> None:
        """Keep the first message in its place, and accept its repetitions.

        Raises
        ------
        ConflictError
            If a message differs from the first one in its place.
        MalformedMessageError
            If it is not a message of this swarm.
        """
        if topic in SEVERAL:
            return
        step, place = step_of(data, topic.type_name), data[_place_in_step(topic)]
        messages = self._steps.get(step)
        if messages is None:
            messages = self._steps[step] = {}
            if len(self._steps) > self._most:
                del self._steps[next(iter(self._steps))]
        first = messages.setdefault((topic, place), data)
        if first is data or first == data:
            return
        if canonical(topic.message, first) != canonical(topic.message, data):
            of = f" of agent {int.from_bytes(place[:2], 'little')}" if place else ""
            raise ConflictError(topic.name + of, step)
