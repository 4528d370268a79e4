"""Who hears whom where each robot sums up the swarm by itself, by the diagnostics of their nodes."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_config.graph import SILENCE
from swarmabs_core.hearing import Hearing
from swarmabs_core.nodes import ROBOT_PREFIX, agent_name
from swarmabs_view.protocol import LinkedRobot, Links

if TYPE_CHECKING:
    from collections.abc import Mapping

INTERVAL = 1.0
"""Time, s, between two messages: each robot publishes its diagnostics that often, but not at the same moment."""

_ID = re.compile("[0-9]{3,5}")


class _Heard(NamedTuple):
    at: float
    hearing: Hearing


class DiagnosedLinks:
    """What the robots of a swarm in real time publish with their diagnostics of whom they hear."""

    def __init__(self) -> None:
        self._heard: dict[int, _Heard] = {}
        self._begun = 0.0
        self._message: Links | None = None
        self._due = float("-inf")

    def hear(self, node: str, values: Mapping[str, str], now: float) -> None:
        """Take the values of a node's diagnostics at a time (s); those that tell no such thing are ignored."""
        number = node.removeprefix(ROBOT_PREFIX)
        robot = int(number) if _ID.fullmatch(number) else 0
        if agent_name(robot) == node and (hearing := Hearing.read(values)):
            if not self._heard:
                self._begun = now
            self._heard[robot] = _Heard(now, hearing)

    def message(self, now: float) -> Links | None:
        """Return who hears whom at a time (s), None where no robot has told; the same one for an interval."""
        if self._heard and now >= self._due:
            self._due = now + INTERVAL
            self._message = Links(robots=self._robots(now))
        return self._message

    def _robots(self, now: float) -> list[LinkedRobot]:
        """Return the robots that speak, and as silent those that they name, so none that has left and was removed."""
        speaking = {robot: hearing for robot, (at, hearing) in self._heard.items() if now - at <= SILENCE}
        named = {robot for hearing in speaking.values() for robot in (*hearing.hears, *hearing.lacks)}
        if now - self._begun <= SILENCE:  # the others may not have spoken yet
            named &= self._heard.keys()
        silent = (named if speaking else self._heard.keys()) - speaking.keys()
        shown = [_shown(robot, hearing) for robot, hearing in speaking.items()]
        return sorted([*shown, *map(_silent, silent)], key=lambda robot: robot.id)


def _shown(robot: int, hearing: Hearing) -> LinkedRobot:
    return LinkedRobot(
        id=robot,
        silent=False,
        hears=list(hearing.hears),
        neighbours=hearing.neighbours,
        oldest=hearing.oldest,
        lacks=list(hearing.lacks),
        majority=hearing.majority,
    )


def _silent(robot: int) -> LinkedRobot:
    return LinkedRobot(id=robot, silent=True, hears=[], neighbours=0, oldest=None, lacks=[], majority=False)
