"""Node ``feeder``: publishes precomputed messages of a run as fast as the recorder accepts them."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from swarmabs_config.graph import Endpoints, requested
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, NEVER, RECORDING_PROGRESS, RecordingProgress
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.scenario_file import ScenarioFile
from swarmabs_run.simulation import Simulation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_core.messages import Message, Messages, Topic
    from swarmabs_ros.status import StatusChannel

PARAMETERS = (ScenarioFile,)

IN_FLIGHT = 3000
"""Limit of messages in flight: the capacity of a socket buffer."""
FEWEST, MOST = 12, 100
"""Bounds of the number of steps that the recorder may lag behind; it reports progress every ten steps."""


class Feeder:
    """Keeps a recorder supplied.

    Parameters
    ----------
    steps : sequence
        The messages of each step.
    """

    def __init__(self, steps: Sequence[Sequence[Message]]) -> None:
        self._steps = steps
        self._sent = 0
        self._written = -1
        self._window = min(MOST, max(FEWEST, IN_FLIGHT // len(steps[0])))

    def start(self) -> Messages:
        """Send the first steps."""
        return self._send_next()

    def handle(self, message: Message) -> Messages:
        """Send as many further steps as have been recorded."""
        if isinstance(message, RecordingProgress) and message.written_step != NEVER:
            self._written = max(self._written, message.written_step)
        return self._send_next()

    def awaits(self) -> tuple[Topic, ...]:
        """Wait for the recorder until it has recorded everything."""
        return () if self._written + 1 == len(self._steps) else (RECORDING_PROGRESS,)

    def missing(self) -> tuple[int, tuple[str, ...]]:
        """Return the first step that has not been recorded."""
        return self._written + 1, ("recorder",)

    def _send_next(self) -> Messages:
        until = min(len(self._steps), self._written + 1 + self._window)
        messages = tuple(message for step in self._steps[self._sent : until] for message in step)
        self._sent = max(self._sent, until)
        return messages


def make(settings: Settings, status: StatusChannel) -> NodeSpec:
    """Return behaviour and endpoints; raises `InputError` if no scenario is given."""
    scenario = settings.declared(ScenarioFile).load()
    singly = (step for steps in Simulation(scenario).steps() for step in steps.singly())
    steps = [[record.message for record in step.records] for step in singly]
    subscriptions = {RECORDING_PROGRESS: requested(RECORDING_PROGRESS, depth=1)}
    return NodeSpec(Feeder(steps), Endpoints((*MAIN_TOPICS, EVENTS), subscriptions))


main = LockstepProgram("feeder", PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())
