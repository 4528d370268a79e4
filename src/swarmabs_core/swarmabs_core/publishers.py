"""Which node published a message."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.desired_state import TORQUE_LIMITED
from swarmabs_core.errors import InputError
from swarmabs_core.messages import FAMILIES, OBSERVER_NODE, ROBOT_STATES, STANDING, TOPIC_OF, EventKind, SwarmEvent
from swarmabs_core.robot_controller import COMMAND_LIMITED
from swarmabs_core.steering import DISTURBANCE
from swarmabs_core.systems.desired import NEED_LIMITED

if TYPE_CHECKING:
    from swarmabs_core.messages import Message


class NodeKind(str, Enum):
    """The function of a node in the swarm."""

    PARENT = "parent"
    OBSERVER = "observer"
    CONTROLLER = "controller"
    AGENT = "agent"


class NodeName(NamedTuple):
    """A node of a run, written as ``parent``, ``observer``, ``controller`` or ``agent:N``."""

    kind: NodeKind
    agent_id: int = 0

    def __str__(self) -> str:
        return f"{self.kind.value}:{self.agent_id}" if self.kind is NodeKind.AGENT else self.kind.value

    @classmethod
    def parse(cls, text: str) -> NodeName:
        """Parse the name of a node; ``plane`` is another name of the parent.

        Raises
        ------
        InputError
            If it is not such a name.
        """
        text = "parent" if text == "plane" else text
        kind, colon, number = text.partition(":")
        try:
            name = cls(NodeKind(kind), int(number) if colon else 0)
        except ValueError:
            name = None
        if name is None or (name.kind is NodeKind.AGENT) != bool(colon) or str(name) != text:
            raise InputError(f"there is no node {text!r}; use controller, observer, parent, or agent:N for a robot")
        return name


PARENT, OBSERVER, CONTROLLER = (NodeName(kind) for kind in (NodeKind.PARENT, NodeKind.OBSERVER, NodeKind.CONTROLLER))

PUBLISHER = {
    topic: node
    for family in FAMILIES
    for topic, node in (
        *((topic, PARENT) for topic in (family.parent, *family.once)),
        *((topic, OBSERVER) for topic in (family.abstract, family.auxiliary)),
        (family.desired, CONTROLLER),
        (STANDING, OBSERVER),
    )
}
"""Publisher of each topic with a single publisher."""
_ANNOUNCED_BY_OBSERVER = (EventKind.JOINED, EventKind.LEFT, EventKind.DEAD)
_ANNOUNCED_BY_ROBOTS = (EventKind.SAFE_STOP, EventKind.HELD, EventKind.RECOVERED, EventKind.FAULT_INJECTED)


def publisher_of(message: Message) -> NodeName:
    """Return the node that published an event, or a message of a main topic."""
    if isinstance(message, ROBOT_STATES):
        return NodeName(NodeKind.AGENT, message.agent_id)
    if isinstance(message, SwarmEvent):
        return _announcer(message)
    return PUBLISHER[TOPIC_OF[type(message)]]


def _announcer(event: SwarmEvent) -> NodeName:
    """Return the node that announced an event. Three nodes report limits; their detail texts identify them."""
    if event.kind in _ANNOUNCED_BY_OBSERVER:
        return OBSERVER
    if event.kind in _ANNOUNCED_BY_ROBOTS or (event.agent_id and event.detail == COMMAND_LIMITED):
        return NodeName(NodeKind.AGENT, event.agent_id)
    if event.kind == EventKind.STEERING:
        return PARENT if event.detail == DISTURBANCE else CONTROLLER
    if event.kind == EventKind.LEADING:
        return OBSERVER if event.detail.startswith(OBSERVER_NODE) else CONTROLLER
    asked = event.detail == TORQUE_LIMITED or event.detail.endswith(NEED_LIMITED.format(""))
    return PARENT if event.kind == EventKind.LIMIT_HIT and not asked else CONTROLLER
