"""Swarms in lockstep tolerate the faults that hypothesis draws, and what goes wrong is found."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given, note, settings
from tests.soak.conftest import FEW, LONG
from tests.soak.invariants import last_fault
from tests.soak.scenarios import scenarios
from tests.soak.trial import lockstep_violations
from tests.swarmabs_core.helpers import builtin

from swarmabs_bag.recording import RecordedStep
from swarmabs_config.scenario import Scenario, dump_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.faults import MembershipFault, RobotFault
from swarmabs_core.messages import AgentState
from swarmabs_run.simulation import Simulation

pytestmark = pytest.mark.timeout(300)


@settings(FEW)
@given(scenario=scenarios(duration=14.0, faults_until=7.0))
def test_a_swarm_tolerates_faults(scenario: Scenario) -> None:
    note(dump_scenario(scenario))
    assert lockstep_violations(scenario) == []


@pytest.mark.full
@pytest.mark.timeout(0)
@settings(LONG)
@given(scenario=scenarios())
def test_a_swarm_tolerates_faults_for_long(scenario: Scenario) -> None:
    note(dump_scenario(scenario))
    assert lockstep_violations(scenario) == []


@settings(FEW, max_examples=50)
@given(scenario=scenarios())
def test_what_is_drawn_leaves_a_swarm_what_it_needs_to_recover(scenario: Scenario) -> None:
    count = len(scenario.agents)
    gone = {fault.agent for fault in scenario.faults_of(MembershipFault) if fault.kind != "join"}
    assert count - len(gone) >= max(3, 2 * count // 3)
    assert not gone & {fault.agent for fault in scenario.faults_of(RobotFault) if fault.kind == "lie"}
    assert scenario.faults
    assert last_fault(scenario) * scenario.period <= 18.02
    assert not [text for text in scenario.warnings() if text.startswith("faults")]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return builtin("pd_het_4", "duration=6")


def broken(scenario: Scenario, steps: Iterator[RecordedStep] | None = None) -> list[object]:
    runs = iter([steps] if steps is not None else [])
    found = lockstep_violations(scenario, lambda: next(runs, Simulation(scenario).steps()))
    return [violation[:3] for violation in found]


def test_nothing_is_wrong_with_a_run_as_it_is(scenario: Scenario) -> None:
    assert broken(scenario) == []


def test_a_message_that_does_not_follow_is_found(scenario: Scenario) -> None:
    def nudged() -> Iterator[RecordedStep]:
        for step in Simulation(scenario).steps():
            if step.step == 40:
                first, *others = step.records
                assert isinstance(first.message, AgentState)
                changed = first.message._replace(position=first.message.position + 1e-15)
                yield step._replace(records=(first._replace(message=changed, payload=encode(changed)), *others))
            else:
                yield step

    assert ("verification", 40, 1) in broken(scenario, nudged())


def test_a_run_that_cannot_be_repeated_is_found(scenario: Scenario) -> None:
    runs = iter([Simulation(scenario).steps(), (step for step in Simulation(scenario).steps() if step.step != 7)])
    assert [violation[:3] for violation in lockstep_violations(scenario, lambda: next(runs))] == [
        ("repetition", None, None)
    ]


def test_a_run_that_fails_is_found(scenario: Scenario) -> None:
    def failing() -> Iterator[RecordedStep]:
        for step in Simulation(scenario).steps():
            if step.step == 100:
                raise RunError("the plane turns over")
            yield step

    (found,) = lockstep_violations(scenario, failing)
    assert (found.invariant, found.text) == ("run", "the plane turns over")
