"""Each invariant holds in a run as it is, and is found broken in one that was tampered with."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import pytest
from tests.soak.invariants import Violation, last_fault, lockstep_invariants
from tests.soak.trial import violations
from tests.swarmabs_core.helpers import builtin

from swarmabs_bag.recording import RecordedStep
from swarmabs_config.scenario import Scenario
from swarmabs_core.messages import NEVER, AgentState, EventKind, Message, PlaneState, SwarmEvent
from swarmabs_run.simulation import Simulation

FAULTS = (
    "faults=[{kind: loss, probability: 0.5, agents: [1, 2], to: 1}, {kind: delay, steps: 2, from: 0.5, to: 1},"
    " {kind: reordering, probability: 0.5, steps: 3, to: 2}, {at: 0.3, kind: join, agent: 2}]"
)
CALM = ("duration=6", "limits={velocity: 5, force: 5}")


@cache
def world(*overrides: str) -> tuple[Scenario, tuple[RecordedStep, ...]]:
    scenario = builtin("pd_het_4", *CALM, *overrides)
    return scenario, tuple(Simulation(scenario).steps())


def tampered(steps: tuple[RecordedStep, ...], change: Callable[[Message], Message | None]) -> Iterator[RecordedStep]:
    for step in steps:
        changed = ((record, change(record.message)) for record in step.records)
        yield step._replace(records=tuple(r._replace(message=m) for r, m in changed if m is not None))


def found(change: Callable[[Message], Message | None], *overrides: str) -> list[Violation]:
    scenario, steps = world(*overrides)
    return violations(lambda: tampered(steps, change), lockstep_invariants(scenario))


def places(found: list[Violation]) -> list[tuple[str, int | None, int | None]]:
    return [violation[:3] for violation in found]


OFF = ("plane.length=0.2502",)


@pytest.mark.parametrize("overrides", [(), (FAULTS,), OFF])
def test_a_run_as_it_is(overrides: tuple[str, ...]) -> None:
    assert found(lambda message: message, *overrides) == []


def test_a_robot_beyond_the_end_needs_an_event() -> None:
    def moved(message: Message) -> Message:
        if isinstance(message, AgentState) and message.agent_id == 3 and 100 <= message.step < 110:
            return message._replace(position=0.51)
        return message

    assert places(found(moved)) == [("lane", 100, 3)]


def test_an_event_of_a_robot_beyond_the_end_that_is_missing() -> None:
    _, steps = world(*OFF)
    said = [r.message for s in steps for r in s.records if isinstance(r.message, SwarmEvent)]
    first = next(e for e in said if e.kind == EventKind.LIMIT_HIT and "plane's end" in e.detail)
    missing = found(lambda message: None if message is first else message, *OFF)
    assert places(missing) == [("lane", first.step, first.agent_id)]


def test_a_liars_true_place_counts() -> None:
    lie = "faults=[{kind: lie, agent: 3, position_offset: 0.45, to: 2}]"
    assert places([v for v in found(lambda message: message, lie) if v.invariant == "lane"]) == []


@pytest.mark.parametrize(("wrong", "overrides"), [(298, ()), (300, ()), (NEVER, ()), (296, (FAULTS,))])
def test_a_command_on_other_broadcasts_than_the_newest(wrong: int, overrides: tuple[str, ...]) -> None:
    def older(message: Message) -> Message:
        if isinstance(message, AgentState) and (message.step, message.agent_id) == (300, 1):
            return message._replace(broadcast_step=wrong)
        return message

    assert places(found(older, *overrides)) == [("stale data", 300, 1)]


def test_numbers_and_commands_beyond_all_limits() -> None:
    def wild(message: Message) -> Message:
        if isinstance(message, AgentState) and (message.step, message.agent_id) == (200, 4):
            return message._replace(command=-5.5)
        if isinstance(message, PlaneState) and message.step == 300:
            return message._replace(angular_velocity=float("nan"))
        return message

    assert places(found(wild)) == [("limits", 200, 4), ("finite numbers", 300, None)]


def test_a_plane_that_is_still_tilted() -> None:
    def tilted(message: Message) -> Message:
        if isinstance(message, PlaneState) and message.step == 600:
            return message._replace(angle=0.011)
        return message

    assert places(found(tilted, FAULTS)) == [("recovery", 200, None)]


def test_the_last_fault() -> None:
    assert last_fault(world(FAULTS)[0]) == 200
    assert last_fault(world()[0]) == 0
    assert last_fault(builtin("pd_het_4", "duration=6", "faults=[{kind: loss, probability: 0.1}]")) == 600
