"""The nodes of a run by their function in the swarm."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from swarmabs_core.errors import InputError

ROBOT_PREFIX = "agent_"
"""What the name of a robot's node begins with."""


def agent_name(agent_id: int) -> str:
    """Return the node name of a robot."""
    return f"{ROBOT_PREFIX}{agent_id:03d}"


class NodeKind(str, Enum):
    """The function of what publishes messages in the swarm."""

    PARENT = "parent"
    OBSERVER = "observer"
    CONTROLLER = "controller"
    AGENT = "agent"
    RECORDER = "recorder"
    OPERATOR = "operator"


_NAMED = (NodeKind.PARENT, NodeKind.OBSERVER, NodeKind.CONTROLLER, NodeKind.AGENT)


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
        if name is None or name.kind not in _NAMED or (name.kind is NodeKind.AGENT) != bool(colon) or str(name) != text:
            raise InputError(f"there is no node {text!r}", "use controller, observer, parent, or agent:N for a robot")
        return name


PARENT, OBSERVER, CONTROLLER = (NodeName(kind) for kind in (NodeKind.PARENT, NodeKind.OBSERVER, NodeKind.CONTROLLER))
