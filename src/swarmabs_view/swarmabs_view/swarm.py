"""Follows a swarm of the ROS domain of the environment, of which nothing is known but what it says."""

from __future__ import annotations

import os

from swarmabs_core.swarm_state import SwarmState
from swarmabs_run.orchestration.tracing_files import tracing_files_removed
from swarmabs_view.facts import UNKNOWN
from swarmabs_view.protocol import Hello

with tracing_files_removed():
    from swarmabs_view.live import Listener, LiveSession, LiveView


class SwarmView:
    """A swarm in a namespace.

    Parameters
    ----------
    namespace : str
        Its namespace.
    """

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        hello = Hello(
            source="swarm",
            title=f"swarm {namespace}",
            place=f"namespace {namespace} of ROS domain {domain}",
            playback=False,
            **UNKNOWN,
        )
        self._live = LiveView(hello, SwarmState())

    def session(self) -> LiveSession:
        """Return what a new page sees."""
        return LiveSession(self._live)

    async def follow(self) -> None:
        """Listen for ever."""
        listener = Listener(self._namespace, 0)
        try:
            await self._live.listen(listener, lambda: False)
        finally:
            listener.close()
