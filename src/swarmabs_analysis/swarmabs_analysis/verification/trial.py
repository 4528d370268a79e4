"""Trials: selected nodes of a recorded run with other settings, and what they answer to the recorded messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from swarmabs_analysis.comparison.messages import MessageComparison
from swarmabs_config import configure
from swarmabs_config.publishers import publisher_of
from swarmabs_core.errors import InputError
from swarmabs_core.messages import SystemDescription
from swarmabs_core.nodes import NodeKind
from swarmabs_core.record import Record
from swarmabs_run.simulation import nodes_in_process

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from swarmabs_analysis.verification.base import VerificationResult
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message, Messages
    from swarmabs_core.nodes import NodeName
    from swarmabs_core.systems.interface import NamedSystem
    from swarmabs_run.simulation import NodeInProcess

_MOST_NAMED = 20


class Trial:
    """Nodes of a recorded run with the settings of a changed scenario.

    A trial is open loop: the nodes receive recorded messages only and keep their own memory. Their messages, without
    events, are compared with the recorded ones.

    Parameters
    ----------
    nodes : sequence of NodeName
        The nodes under test.
    overrides : sequence of str
        The changes that `scenario` includes, each ``a.b=value``.
    scenario, recorded : Scenario
        The changed scenario, and that of the recording.

    Raises
    ------
    InputError
        If the scenario lacks a node, or a change contradicts the recorded messages.
    """

    def __init__(
        self, nodes: Sequence[NodeName], overrides: Sequence[str], scenario: Scenario, recorded: Scenario
    ) -> None:
        self.nodes = tuple(dict.fromkeys(nodes))
        self.overrides = tuple(overrides)
        self._scenario = scenario
        self._changed, self._recorded = scenario.named, recorded.named
        self._comparison = MessageComparison()
        check_nodes(self.nodes, recorded)
        _check_changes(scenario, recorded)

    def in_process(self, division: int) -> dict[NodeName, NodeInProcess]:
        """Return the nodes under test; `division` is as for `nodes_in_process`."""
        nodes = nodes_in_process(self._scenario, division)
        return {name: nodes[name] for name in self.nodes}

    def hearing(self, name: NodeName, handle: Callable[[Message], Messages]) -> Callable[[Message], Messages]:
        """Return the function by which a node receives recorded messages.

        Nodes under test receive them as if they referred to the changed parent system.
        """
        if name not in self.nodes or self._changed == self._recorded:
            return handle
        return lambda message: handle(_referring(message, self._changed))

    def compare(self, stored: Record, answer: Message) -> None:
        """Compare the answer of a node with the recorded message, if the node is under test."""
        if publisher_of(answer) in self.nodes:
            self._comparison.take(stored, Record.of(_referring(answer, self._recorded)))

    def report(self, result: VerificationResult) -> None:
        """Complete a result by the comparison of all answers."""
        compared = self._comparison.finish()
        result.messages = sum(topic.compared for topic in compared.topics)
        result.difference = result.difference or compared.first
        result.trial = {
            "nodes": list(map(str, self.nodes)),
            "overrides": list(self.overrides),
            "deviations": compared.deviations(),
        }


def check_nodes(nodes: Iterable[NodeName], recorded: Scenario) -> None:
    """Raise `InputError` if one of the nodes is a robot that the scenario of a recording lacks."""
    members = sorted(configure.members(recorded))
    for node in nodes:
        if node.kind is NodeKind.AGENT and node.agent_id not in members:
            more = " ..." if len(members) > _MOST_NAMED else ""
            ids = ", ".join(map(str, members[:_MOST_NAMED]))
            raise InputError(f"--node {node}: the scenario has no robot {node.agent_id}; it has {ids}{more}")


def _check_changes(scenario: Scenario, recorded: Scenario) -> None:
    for what in _contradicted(scenario, recorded):
        raise InputError(f"--set changes the {what}, but the messages of the other nodes are recorded; use run instead")


def _contradicted(scenario: Scenario, recorded: Scenario) -> Iterator[str]:
    """Yield what a changed scenario must have in common with the recorded one and has not."""
    for what, of in (
        ("control period", lambda given: given.step_ns),
        ("duration", lambda given: given.steps),
        ("robots", configure.members),
        ("faults that end robots or let them join", configure.schedule),
        ("reaction to silent robots", lambda given: given.lockstep.on_stall),
        ("quantities of the parent system", lambda given: given.tables._replace(settings={})),
    ):
        if of(scenario) != of(recorded):
            yield what


def _referring(message: Message, system: NamedSystem | None) -> Message:
    """Return a message as if it referred to a parent system."""
    fields: Any = message
    if system is None or getattr(message, "system", system.hash) == system.hash:
        return message
    also = {"description": system.description} if isinstance(message, SystemDescription) else {}
    changed: Message = fields._replace(system=system.hash, **also)
    return changed
