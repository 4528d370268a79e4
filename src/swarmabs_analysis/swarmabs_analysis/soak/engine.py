"""What makes the steps of a soak."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from swarmabs_analysis.soak.invariants import NothingStale, Recovers, StaysInLane, WithinLimits
from swarmabs_core.messages import EVENTS, MAIN_TOPICS
from swarmabs_run.simulation import Simulation

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_analysis.soak.invariants import Invariant
    from swarmabs_bag.recording import RecordedStep
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Topic


class Engine(Protocol):
    """A way to run a scenario in this process, and what holds when it is run so."""

    @property
    def name(self) -> str:
        """What the report, and the provenance of a bag, call it."""
        ...

    @property
    def topics(self) -> tuple[Topic, ...]:
        """What its bags hold."""
        ...

    @property
    def verifiable(self) -> bool:
        """Whether `verify` can recompute a bag of it."""
        ...

    def prepare(self, scenario: Scenario) -> Scenario:
        """Return a drawn scenario as it can be run here."""
        ...

    def kinds(self, scenario: Scenario) -> list[str]:
        """Return what is done to the swarm, in words, ascending."""
        ...

    def steps(self, scenario: Scenario) -> Iterator[RecordedStep]:
        """Run a scenario and yield its steps.

        Raises
        ------
        RunError
            If the run fails.
        """
        ...

    def invariants(self, scenario: Scenario) -> tuple[Invariant, ...]:
        """Return what is to be checked."""
        ...


class LockstepEngine:
    """The state machines of all nodes, connected by a queue, with the step as the clock."""

    name = "simulate"
    verifiable = True
    topics = (*MAIN_TOPICS, EVENTS)

    def prepare(self, scenario: Scenario) -> Scenario:
        """Return the scenario as it is."""
        return scenario

    def kinds(self, scenario: Scenario) -> list[str]:
        """Return the kinds of the scenario's faults."""
        return sorted(fault.kind for fault in scenario.faults)

    def steps(self, scenario: Scenario) -> Iterator[RecordedStep]:
        """Simulate a scenario."""
        return Simulation(scenario).steps()

    def invariants(self, scenario: Scenario) -> tuple[Invariant, ...]:
        """Return all invariants."""
        return StaysInLane(scenario), NothingStale(scenario), WithinLimits(scenario), Recovers(scenario)
