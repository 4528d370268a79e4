"""What nodes tell the orchestrator about events: the nodes what they publish, the recorder what it records.

A step may have any number of events, from any node, so messages do not show which ones belong to the run. Only the
nodes of the run know, and only they write to its status channel.
"""

from __future__ import annotations

from hashlib import blake2b
from typing import TYPE_CHECKING, Literal

from swarmabs_core.cdr import encode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.messages import SwarmEvent
    from swarmabs_ros.status import StatusChannel

_MOST = 50
"""Events of one report, which must stay below 4 KiB."""


def send_events(status: StatusChannel, report: Literal["publishes", "recorded"], events: Sequence[SwarmEvent]) -> None:
    """Report events, each as digest, step, robot and kind; a node does so before it publishes them."""
    digests = [
        (blake2b(encode(event), digest_size=8).hexdigest(), event.step, event.agent_id, event.kind) for event in events
    ]
    for first in range(0, len(digests), _MOST):
        status.send(report, events=digests[first : first + _MOST])
