"""Which node published a message."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config.graph import CONTROLLER, GRAPH, OBSERVER, PLANE
from swarmabs_core.events import code_of
from swarmabs_core.messages import FAMILIES, ROBOT_STATES, TOPIC_OF, SwarmEvent
from swarmabs_core.nodes import NodeKind, NodeName

if TYPE_CHECKING:
    from swarmabs_core.messages import Message

_COORDINATORS = {PLANE: NodeKind.PARENT, OBSERVER: NodeKind.OBSERVER, CONTROLLER: NodeKind.CONTROLLER}
PUBLISHER = {
    topic: NodeName(_COORDINATORS[end.node])
    for link in GRAPH
    for topic in link.topics
    if any(topic in family.recorded for family in FAMILIES)
    for end in link.writers
    if end.node in _COORDINATORS
}
"""The coordinator that publishes each of the recorded topics of a run, events and robots' states aside."""


def publisher_of(message: Message) -> NodeName | None:
    """Return the node that published an event, or a message of a recorded topic; None if an event does not tell."""
    if isinstance(message, ROBOT_STATES):
        return NodeName(NodeKind.AGENT, message.agent_id)
    if isinstance(message, SwarmEvent):
        code = code_of(message)
        if code is None or code.source is None:
            return None
        return NodeName(code.source, message.agent_id if code.source is NodeKind.AGENT else 0)
    return PUBLISHER[TOPIC_OF[type(message)]]
