"""Swarms in lockstep tolerate the faults that hypothesis draws and hold no more and more; what goes wrong is found."""

import gc
from collections.abc import Callable, Iterator
from functools import cache
from math import nan
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import psutil
import pytest
from hypothesis import HealthCheck, Phase, given, note, settings
from tests.soak.invariants import last_fault, lockstep_violations, violations
from tests.soak.scenarios import scenarios
from tests.swarmabs_core.helpers import builtin, singly

from swarmabs_bag.run.step import Step
from swarmabs_config.scenario import Scenario, dump_scenario, warnings_of
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.faults import MembershipFault, RobotFault
from swarmabs_core.messages import NEVER, AgentState, EventKind, Message, PlaneState, SwarmEvent
from swarmabs_core.record import Record
from swarmabs_run.simulation import Simulation

pytestmark = pytest.mark.timeout(300)

LONG = settings(
    max_examples=settings().max_examples if settings.get_current_profile_name() == "hours" else 50,
    deadline=None,
    phases=(Phase.explicit, Phase.reuse, Phase.generate),  # nothing is made simpler: each run takes seconds
    suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example),
    print_blob=True,
)
"""The same runs each time, and with the profile `hours` others; what fails of these is run first the next time."""


@pytest.mark.full
@pytest.mark.timeout(0)
@settings(LONG)
@given(scenario=scenarios())
def test_a_swarm_tolerates_faults(scenario: Scenario) -> None:
    note(dump_scenario(scenario))
    assert lockstep_violations(scenario) == []


@settings(LONG, max_examples=50, derandomize=True, database=None)
@given(scenario=scenarios())
def test_what_is_drawn_leaves_a_swarm_what_it_needs_to_recover(scenario: Scenario) -> None:
    count = len(scenario.agents)
    gone = {fault.agent for fault in scenario.faults_of(MembershipFault) if fault.kind != "join"}
    assert count - len(gone) >= max(3, 2 * count // 3)
    assert not gone & {fault.agent for fault in scenario.faults_of(RobotFault) if fault.kind == "lie"}
    assert scenario.faults
    assert last_fault(scenario) * scenario.period <= 18.02
    assert not [text for text in warnings_of(scenario) if text.startswith("faults")]


CALM = builtin("pd_het_4", "duration=2", "plane.angle=0")


def changed_at(step: int, change: Callable[[Step], Step | None]) -> Iterator[Step]:
    """Yield the steps of a run of which one is changed, or left out."""
    for original in singly(Simulation(CALM).steps()):
        changed = change(original) if original.step == step else original
        if changed is not None:
            yield changed


def nudged(step: Step) -> Step:
    first, *others = step.records
    assert isinstance(first.message, AgentState)
    changed = first.message._replace(position=first.message.position + 1e-15)
    return Step.of(step.step, (first._replace(message=changed, payload=encode(changed)), *others))


def failing(_: Step) -> Step:
    raise RunError("the plane turns over")


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (lambda step: step, lambda step: step, []),
        (lambda step: step, lambda _: None, [("repetition", None, None)]),
        (nudged, nudged, [("verification", 40, 1)]),
        (failing, None, [("run", None, None)]),
    ],
)
def test_what_is_wrong_with_a_run_is_found(first: Any, second: Any, expected: list[object]) -> None:
    runs = iter((first, second))
    assert [violation[:3] for violation in lockstep_violations(CALM, lambda: changed_at(40, next(runs)))] == expected


FAULTS = (
    "faults=[{kind: loss, probability: 0.5, agents: [1, 2], to: 1}, {kind: delay, steps: 2, from: 0.5, to: 1},"
    " {kind: reordering, probability: 0.5, steps: 3, to: 2}, {at: 0.3, kind: join, agent: 2}]"
)
LIE = "faults=[{kind: lie, agent: 3, position_offset: 0.45, to: 2}]"
OFF = "plane.length=0.2502"
QUIET = ("duration=6", "limits={velocity: 5, force: 5}")


@cache
def world(*overrides: str) -> tuple[Scenario, tuple[Step, ...]]:
    scenario = builtin("pd_het_4", *QUIET, *overrides)
    return scenario, singly(Simulation(scenario).steps())


def violations_where(changes: dict[Any, dict[str, Any]], *overrides: str) -> list[tuple[str, int | None, int | None]]:
    """Return what is found where messages, by (class, step, robot), are changed."""
    scenario, steps = world(*overrides)

    def change(record: Record) -> Record:
        message: Any = record.message
        fields = changes.get((type(message), message.step, record.agent_id), {})
        return Record.of(message._replace(**fields)) if fields else record

    tampered = (Step.of(step.step, tuple(map(change, step.records))) for step in steps)
    return [violation[:3] for violation in violations(scenario, tampered)]


@pytest.mark.parametrize(
    ("name", "place", "fields", "overrides"),
    [
        *((None, (AgentState, 100, 3), {}, overrides) for overrides in ((), (FAULTS,), (OFF,))),
        ("lane", (AgentState, 100, 3), {"position": 0.51}, ()),
        ("stale data", (AgentState, 300, 1), {"broadcast_step": 298}, ()),
        ("stale data", (AgentState, 300, 1), {"broadcast_step": 300}, ()),
        ("stale data", (AgentState, 300, 1), {"broadcast_step": NEVER}, ()),
        ("stale data", (AgentState, 300, 1), {"broadcast_step": 296}, (FAULTS,)),
        ("limits", (AgentState, 200, 4), {"command": -5.5}, ()),
        ("finite numbers", (PlaneState, 300, 0), {"angular_velocity": nan}, ()),
    ],
)
def test_each_invariant_holds_in_a_run_and_is_found_broken_if_one_message_is_changed(
    name: str | None, place: tuple[type[Message], int, int], fields: dict[str, Any], overrides: tuple[str, ...]
) -> None:
    assert violations_where({place: fields}, *overrides) == ([(name, place[1], place[2] or None)] if name else [])


def test_a_robot_beyond_the_end_needs_an_event_and_its_true_place_counts() -> None:
    events = [r.message for s in world(OFF)[1] for r in s.records if isinstance(r.message, SwarmEvent)]
    first = next(e for e in events if e.kind == EventKind.LIMIT_HIT and "out of range" in e.detail)
    unsaid = {(SwarmEvent, first.step, first.agent_id): {"detail": ""}}
    assert violations_where(unsaid, OFF) == [("lane", first.step, first.agent_id)]
    assert "lane" not in {name for name, *_ in violations_where({}, LIE)}


def test_recovery_counts_from_the_last_fault_to_the_end() -> None:
    assert violations_where({(PlaneState, 600, 0): {"angle": 0.011}}, FAULTS) == [("recovery", 200, None)]
    assert last_fault(world(FAULTS)[0]) == 200
    assert last_fault(world()[0]) == 0
    assert last_fault(builtin("pd_het_4", "duration=6", "faults=[{kind: loss, probability: 0.1}]")) == 600


WARM_UP = 5
"""Runs in which caches may fill."""


class Sample(NamedTuple):
    """What a process holds between two runs: resident memory in MiB, and counts."""

    memory: float
    objects: float
    descriptors: float
    threads: float
    children: float


ALLOWED = Sample(24.0, 2000, 0, 0, 0)
"""By how much runs of different size may differ for no reason."""


def sample() -> Sample:
    gc.collect()
    process = psutil.Process()
    memory = process.memory_info().rss / 2**20
    return Sample(memory, len(gc.get_objects()), process.num_fds(), process.num_threads(), len(process.children()))


def grown(samples: list[Sample]) -> list[str]:
    """Name what the last third of the runs after the warm-up holds more of than the first."""
    warm = samples[WARM_UP:]
    third = len(warm) // 3
    early, late = (list(map(median, zip(*part, strict=True))) for part in (warm[:third], warm[-third:]))
    return [
        name
        for name, before, after, allowed in zip(Sample._fields, early, late, ALLOWED, strict=True)
        if after - before > allowed
    ]


@pytest.mark.system
def test_growth_is_told_from_caches_that_fill_and_runs_of_different_size() -> None:
    calm = Sample(60.0, 50_000, 6, 1, 0)
    for name, growth in (("memory", 3.0), ("objects", 300), ("descriptors", 1), ("threads", 1), ("children", 1)):
        assert grown([calm._replace(**{name: getattr(calm, name) + growth * run}) for run in range(30)]) == [name]
    warm = [calm._replace(memory=20.0 * run, objects=10_000 * run, descriptors=run) for run in range(WARM_UP)]
    steady = [calm._replace(memory=60.0 + 10.0 * (run % 2), objects=50_000 + 500 * (run % 3)) for run in range(20)]
    assert grown([*warm, *steady]) == []
    before = sample()
    with Path(__file__).open(encoding="utf-8"):
        assert sample().descriptors == before.descriptors + 1


@pytest.mark.full
@pytest.mark.timeout(600)
def test_runs_one_after_the_other_hold_no_more_and_more() -> None:
    scenario = builtin("pd_het_4", "duration=6", FAULTS)
    samples = []
    for _ in range(20):
        assert lockstep_violations(scenario) == []
        samples.append(sample())
    assert grown(samples) == []
