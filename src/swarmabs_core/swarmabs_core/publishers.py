"""Which node published a message."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_core.events import code_of
from swarmabs_core.messages import FAMILIES, ROBOT_STATES, STANDING, TOPIC_OF, SwarmEvent
from swarmabs_core.nodes import CONTROLLER, OBSERVER, PARENT, NodeKind, NodeName

if TYPE_CHECKING:
    from swarmabs_core.messages import Message

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


def publisher_of(message: Message) -> NodeName | None:
    """Return the node that published an event, or a message of a main topic; None if an event does not tell."""
    if isinstance(message, ROBOT_STATES):
        return NodeName(NodeKind.AGENT, message.agent_id)
    if isinstance(message, SwarmEvent):
        code = code_of(message)
        if code is None or code.source is None:
            return None
        return NodeName(code.source, message.agent_id if code.source is NodeKind.AGENT else 0)
    return PUBLISHER[TOPIC_OF[type(message)]]
