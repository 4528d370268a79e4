"""What events report: their codes, with source, text and unit of each, and the words in which they are shown.

The bytes of an event hold kind, value and text. Its code follows from them here and nowhere else, so that recordings of
every version are read alike: nodes publish the texts that are declared here, and everything else asks for the code.
"""

from __future__ import annotations

import re
from enum import Enum
from functools import cached_property

from swarmabs_core.messages import CONTROLLER_NODE, OBSERVER_NODE, RECORDER_NODE, EventKind, SwarmEvent, said
from swarmabs_core.nodes import NodeKind

OF_COMMAND = "command"
"""`EventCode.unit` of a value in the unit of the robot's commands."""
_WAITS = "waits to start"
_DISPUTE = "{cause}, of which the bag has only the first, on {where}"


class EventCode(Enum):
    """What has happened, and which node reports it.

    Of the codes of a kind, the first one that fits an event is the event's; the last one fits any text.

    Parameters
    ----------
    kind : EventKind
        The kind of the events.
    source : NodeKind or None
        The node that publishes them; None if several nodes do, without saying which.
    text : str
        Their ``detail``, in which ``{name}`` is any text; empty if it is free.
    unit : str
        Unit of their value, on the plane; `OF_COMMAND`, or empty if there is none.
    words : str
        What is shown instead of the words of the kind.
    """

    ASKED_TO_JOIN = EventKind.JOINED, NodeKind.AGENT, "asked to join"
    JOINED = EventKind.JOINED, NodeKind.OBSERVER, "", "m"
    ASKED_TO_LEAVE = EventKind.LEFT, NodeKind.AGENT, "asked to leave"
    CARRIED_AWAY = EventKind.LEFT, NodeKind.OPERATOR, "carried away"
    REMOVED = EventKind.LEFT, NodeKind.OBSERVER, "remove", "m"
    LEFT = EventKind.LEFT, NodeKind.OBSERVER, "", "m"
    SILENT = EventKind.DEAD, NodeKind.OBSERVER, "silent", "m"
    KILLED = EventKind.DEAD, NodeKind.OBSERVER, "kill", "m"
    FROZEN = EventKind.DEAD, NodeKind.OBSERVER, "freeze", "m"
    DEAD = EventKind.DEAD, NodeKind.OBSERVER, "", "m"
    NO_BROADCASTS = EventKind.SAFE_STOP, NodeKind.AGENT, "no complete broadcasts yet", "", _WAITS
    SAFE_STOP = EventKind.SAFE_STOP, NodeKind.AGENT, ""
    NO_FOLLOWER = EventKind.HELD, NodeKind.AGENT, "no robot follows the law yet{why}", "", _WAITS
    HELD = EventKind.HELD, NodeKind.AGENT, ""
    WITHIN_LIMITS = EventKind.RECOVERED, NodeKind.AGENT, "command within its limits"
    SENSOR_HEARD = EventKind.RECOVERED, NodeKind.PARENT, "the plane's sensor is heard", "s"
    RECOVERED = EventKind.RECOVERED, NodeKind.AGENT, ""
    FAULT_INJECTED = EventKind.FAULT_INJECTED, NodeKind.AGENT, ""
    COMMAND_LIMITED = EventKind.LIMIT_HIT, NodeKind.AGENT, "command limited", OF_COMMAND
    LANE_LIMITED = EventKind.LIMIT_HIT, NodeKind.AGENT, "command limited by the end of the lane", OF_COMMAND
    TORQUE_LIMITED = EventKind.LIMIT_HIT, NodeKind.CONTROLLER, "torque limited to torque_max", "N m"
    NEED_LIMITED = EventKind.LIMIT_HIT, NodeKind.CONTROLLER, "{need} limited"
    OUT_OF_RANGE = EventKind.LIMIT_HIT, NodeKind.PARENT, "out of range: {where}", "m"
    FAR_OUT_OF_RANGE = EventKind.LIMIT_HIT, NodeKind.PARENT, "far out of range: {where}", "m"
    BACK_IN_RANGE = EventKind.LIMIT_HIT, NodeKind.PARENT, "back in range: {where}", "m"
    OFF_END = EventKind.LIMIT_HIT, NodeKind.PARENT, "off the plane's end", "m"
    END_STOP_HIT = EventKind.LIMIT_HIT, NodeKind.PARENT, "end stop hit{how}", "rad"
    LIMIT_HIT = EventKind.LIMIT_HIT, NodeKind.PARENT, ""
    REFERENCE = EventKind.STEERING, NodeKind.CONTROLLER, "reference", "rad", "reference"
    DISTURBANCE = EventKind.STEERING, NodeKind.PARENT, "disturbance", "N m", "disturbance"
    STEERING = EventKind.STEERING, NodeKind.CONTROLLER, ""
    NO_SENSOR = EventKind.STALLED, NodeKind.PARENT, "the plane's sensor {problem}", "s"
    STALLED = EventKind.STALLED, NodeKind.CONTROLLER, "", "s"
    MODE_CHANGED = EventKind.MODE_CHANGED, NodeKind.CONTROLLER, ""
    DISPUTE_BEGINS = EventKind.REFUSED, NodeKind.RECORDER, f"from this step on {_DISPUTE}"
    DISPUTE_ENDS = EventKind.REFUSED, NodeKind.RECORDER, f"up to this step {_DISPUTE}"
    TWO_MESSAGES = EventKind.REFUSED, NodeKind.RECORDER, "two different messages of this step on {topic}"
    REFUSED_BY_ROBOT = EventKind.REFUSED, NodeKind.AGENT, ""
    REFUSED = EventKind.REFUSED, None, ""
    OBSERVER_LEADS = EventKind.LEADING, NodeKind.OBSERVER, f"{OBSERVER_NODE}{{why}}"
    RECORDER_LEADS = EventKind.LEADING, NodeKind.RECORDER, f"{RECORDER_NODE}{{why}}"
    CONTROLLER_LEADS = EventKind.LEADING, NodeKind.CONTROLLER, f"{CONTROLLER_NODE}{{why}}"
    LEADING = EventKind.LEADING, None, ""

    def __init__(
        self, kind: EventKind, source: NodeKind | None, text: str = "", unit: str = "", words: str = ""
    ) -> None:
        self.kind = kind
        self.source = source
        self.text = text
        self.unit = unit
        self.words = words or said(kind)

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        parts = re.split(r"\{(\w+)\}", self.text)
        return re.compile(
            "".join(f"(?P<{part}>.*?)" if n % 2 else re.escape(part) for n, part in enumerate(parts)), re.DOTALL
        )

    def event(
        self, stamp: int, step: int, value: float = 0.0, *, robot: int = 0, detail: str = "", **parts: object
    ) -> SwarmEvent:
        """Return an event with this code.

        Parameters
        ----------
        stamp, step : int
            Time stamp, ns, and first step at which it holds.
        value : float
            Its value, in the unit of the code.
        robot : int
            The robot concerned, 0 if it concerns no single one.
        detail : str
            The text of a code whose text is free.
        **parts
            What stands for the names in the code's text.
        """
        return SwarmEvent(stamp, step, robot, self.kind, value, detail or self.text.format(**parts))

    def fits(self, event: SwarmEvent) -> bool:
        """Return whether an event of the kind may have this code: only robots report about themselves."""
        own = event.agent_id != 0 or self.source is not NodeKind.AGENT
        return own and (not self.text or self._pattern.fullmatch(event.detail) is not None)

    def read(self, event: SwarmEvent) -> dict[str, str]:
        """Return what stands for the names in the code's text, by name; nothing for another event."""
        match = self._pattern.fullmatch(event.detail)
        return match.groupdict() if match else {}


_OF_KIND = {kind: tuple(code for code in EventCode if code.kind is kind) for kind in EventKind}


def code_of(event: SwarmEvent) -> EventCode | None:
    """Return the code of an event, as in recordings of all versions; None if its kind is not known or fits no code."""
    return next((code for code in _OF_KIND.get(event.kind, ()) if code.fits(event)), None)  # type: ignore[call-overload]


def said_event(event: SwarmEvent) -> str:
    """Return what an event reports, without its value and detail; the number of a kind that is not known.

    A planned or requested change of the disturbance or the reference has the name of what changes, and a robot that has
    not been able to move yet waits.
    """
    if (code := code_of(event)) is not None:
        return code.words
    try:
        return said(EventKind(event.kind))
    except ValueError:
        return f"event {event.kind}"
