"""A simulation that loses robots at any step, and that can be copied before."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

from swarmabs_core.behaviours import Observer
from swarmabs_core.errors import InputError, RunError, one_line
from swarmabs_core.membership import SILENT
from swarmabs_core.nodes import OBSERVER, NodeKind, NodeName
from swarmabs_run.simulation import Network, behaviour_of, nodes_in_process

if TYPE_CHECKING:
    from collections.abc import Collection

    from swarmabs_analysis.losses.measures import Watch
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message


class Rehearsal:
    """The nodes of a scenario in this process, without a recording.

    Attributes
    ----------
    step : int
        The step in which the robots wait for the desired state.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._nodes = nodes_in_process(scenario)
        self._desired = scenario.family.desired.message
        self._network = Network(self._nodes.values())
        self.step = -1

    def copy(self) -> Rehearsal:
        """Return a copy that continues independently.

        Raises
        ------
        InputError
            If a part of an installed package cannot be copied.
        """
        try:
            return copy.deepcopy(self)
        except Exception as error:  # foreign objects may raise anything
            raise InputError(
                f"the parent controller cannot be copied ({one_line(error)})", "give it attributes that can be copied"
            ) from error

    def advance(self, step: int, watch: Watch, lost: Collection[int] = ()) -> None:
        """Simulate until the robots wait for the desired state of a step; robots that are `lost` die at once.

        They have published their last states and remain at rest, as after a fault ``kill``. If the run fails, the
        reason becomes the `failure` of the watch.
        """
        try:
            if self.step < 0:
                self._network.start()
            if lost:
                self._lose(lost, watch)
            self._until(step, watch)
        except RunError as error:
            watch.failure = str(error)

    def _lose(self, lost: Collection[int], watch: Watch) -> None:
        for robot in lost:
            self._network.disconnect(self._nodes[NodeName(NodeKind.AGENT, robot)])
        self._until(self.step + 1, watch)
        observer = behaviour_of(self._nodes, OBSERVER, Observer)
        self._network.pending.extend(observer.drop(lost, SILENT))

    def _until(self, step: int, watch: Watch) -> None:
        def later(message: Message) -> bool:
            return isinstance(message, self._desired) and message.step >= step

        for message in self._network.deliver(later):
            self.step = max(self.step, message.step)
            watch(message)
