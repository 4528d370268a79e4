"""Membership and faults in whole simulations, message by message (docs/reference/faults.md)."""

import hashlib
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from tests.swarmabs_core.helpers import FOUR_ROBOT_SCENARIOS, Run, builtin

from swarmabs_config import configure
from swarmabs_core.abstraction import Weight, abstraction, damping_sums, second_moments
from swarmabs_core.arrays import RunArrays
from swarmabs_core.behaviours import Parent
from swarmabs_core.drive import DoubleIntegratorDrive
from swarmabs_core.faults import LossFault
from swarmabs_core.messages import (
    NEVER,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Kind,
    PlaneState,
    Status,
)
from swarmabs_core.swarm_law import SwarmGains, double_integrator_command, single_integrator_command
from swarmabs_run.simulation import simulate

AT = 50
"""The fault step: round(0.503 s/0.01 s)."""

GAINS = SwarmGains((10.0, 10.0), (10.0, 10.0), (5.0, 5.0), 1.0)


def run_with(fault: str, name: str = "pd_het_4", duration: str = "1.5") -> Run:
    return Run(builtin(name, f"duration={duration}", f"faults=[{{{fault}}}]"))


def assert_sums(run: Run, step: int, standing: tuple[AgentState, ...] = ()) -> None:
    """Check both broadcasts of a step against the robots' states of that step."""
    states = run.states(step)
    weights = [Weight(s.mass, s.position, s.velocity) for s in states]
    weights += [Weight(s.mass, s.position, 0.0) for s in standing]
    total = abstraction(weights, 9.81)
    active = [s for s in states if s.status == Status.ACTIVE]
    damped = [(s.mass, s.position, s.damping) for s in active if s.kind == Kind.DOUBLE_INTEGRATOR]
    abstract, sums = run.one(AbstractState, step), run.one(AuxiliaryState, step)
    assert abstract[2:] == (len(weights), *total[:4])
    assert sums[2:6] == second_moments((s.mass, s.position) for s in active)
    assert sums[6:9] == damping_sums(damped, 1.0)
    assert sums.q == total.q


def command_for(before: AgentState, run: Run, step: int) -> float:
    """Return what the law asks of a robot in a state from the recorded broadcasts of a step."""
    shared = (GAINS, 9.81, *(run.one(kind, step) for kind in (AbstractState, AuxiliaryState, DesiredAbstractState)))
    if before.kind == Kind.SINGLE_INTEGRATOR:
        return single_integrator_command(before.mass, before.position, *shared)
    return double_integrator_command(before.mass, before.damping, before.position, before.velocity, *shared)


def reports(run: Run) -> list[tuple[int, int, EventKind]]:
    return [(e.step, e.agent_id, EventKind(e.kind)) for e in run.events()]


@pytest.mark.parametrize("kind", ["kill", "freeze"])
@pytest.mark.parametrize("robot", [2, 3])
def test_killed_robot(kind: str, robot: int) -> None:
    """Its last state is that of the fault step; then its weight stays in a and leaves the S, D sums."""
    run = run_with(f"at: 0.503, kind: {kind}, agent: {robot}")
    states = run.agent(robot)
    assert list(states) == list(range(AT + 1))
    assert states[AT].status == Status.ACTIVE
    assert reports(run) == [(AT + 1, robot, EventKind.DEAD)]
    assert run.events()[0].detail == kind
    for step in (0, AT - 1, AT):
        assert_sums(run, step)
    for step in (AT + 1, AT + 2, 150):
        assert len(run.states(step)) == 3
        assert_sums(run, step, standing=(states[AT],))
    assert abs(run.of(PlaneState)[-1].angle) < 0.1


def test_leaving_robot() -> None:
    """It says so at the fault step, where it still weighs; from the next step its weight is gone."""
    run = run_with("at: 0.503, kind: leave, agent: 3")
    states = run.agent(3)
    assert list(states) == list(range(AT + 1))
    assert [states[step].status for step in (AT - 1, AT)] == [Status.ACTIVE, Status.LEFT]
    assert reports(run) == [(AT + 1, 3, EventKind.LEFT)]
    assert [run.one(AbstractState, step).agent_count for step in (AT, AT + 1)] == [4, 3]
    for step in (AT - 1, AT, AT + 1, 150):
        assert_sums(run, step)


def test_joining_robot() -> None:
    run = run_with("at: 0.503, kind: join, agent: 3")
    states = run.agent(3)
    assert list(states) == list(range(AT, 151))
    assert states[AT][2:] == (NEVER, 3, Kind.DOUBLE_INTEGRATOR, Status.ACTIVE, 0.6762, 0.6524, 0.125, 0.0, 0.0)
    assert states[AT + 1].broadcast_step == AT
    assert states[AT + 1].command == command_for(states[AT], run, AT)
    assert reports(run) == [(AT, 3, EventKind.JOINED)]
    assert [run.one(AbstractState, step).agent_count for step in (0, AT - 1, AT)] == [3, 3, 4]
    for step in (0, AT - 1, AT, AT + 1, 150):
        assert_sums(run, step)


@pytest.mark.parametrize(("kind", "count"), [("kill", 4), ("leave", 3)])
def test_fault_at_step_0_and_at_the_last_step(kind: str, count: int) -> None:
    first = run_with(f"at: 0, kind: {kind}, agent: 3", duration="0.1")
    assert list(first.agent(3)) == [0]
    assert first.one(AbstractState, 1).agent_count == count
    last = run_with(f"at: 0.1, kind: {kind}, agent: 3", duration="0.1")
    assert list(last.agent(3)) == list(range(11))
    assert last.events() == []


def test_duplication_changes_nothing() -> None:
    assert run_with("kind: duplication, probability: 0.5").digest() == Run(builtin("pd_het_4", "duration=1.5")).digest()


def pairs(run: Run) -> Iterator[tuple[int, int, AgentState, AgentState]]:
    """Yield robot, step, and its states in that step and in the next."""
    for robot in (1, 2, 3, 4):
        states = run.agent(robot)
        for k in range(len(states) - 1):
            yield robot, k, states[k], states[k + 1]


def test_delay() -> None:
    """Broadcasts of step k - n with the robot's own state of step k; command 0 while k < n."""
    run = run_with("kind: delay, steps: 3", duration="0.5")
    for _, k, before, after in pairs(run):
        used = (0.0, NEVER) if k < 3 else (command_for(before, run, k - 3), k - 3)
        assert (after.command, after.broadcast_step) == used


def test_loss() -> None:
    """A robot that misses the broadcasts of a step keeps its command and the step on which that rests."""
    run = run_with("kind: loss, probability: 0.3", duration="2")
    missed = 0
    for robot, k, before, after in pairs(run):
        lost = LossFault(probability=0.3).loses(f"1:{k}:{robot}")
        missed += lost
        used = (before.command, before.broadcast_step) if lost else (command_for(before, run, k), k)
        assert (after.command, after.broadcast_step) == used
    assert 180 < missed < 300


def test_loss_and_delay_of_some_robots_for_a_while() -> None:
    """Outside the robots and times that are named nothing happens; broadcasts on their way arrive all the same."""
    faults = (
        "kind: loss, probability: 1, agents: [2], from: 0.5, to: 0.7}, {kind: delay, steps: 3, agents: [3], from: 1"
    )
    run = run_with(f"{faults}, to: 1.2", duration="2")
    for robot, k, _, after in pairs(run):
        used = 49 if robot == 2 and 50 <= k < 70 else k
        if robot == 3 and 100 <= k < 120:  # three steps late; until the first of them comes, the last before counts
            used = max(99, k - 3)
        assert after.broadcast_step == used
    told = [(e.step, e.agent_id, e.value, e.detail) for e in run.events()]
    assert told == [
        (50, 2, 1.0, "loss of the broadcasts"),
        (70, 2, 0.0, "over: loss of the broadcasts"),
        (100, 3, 3.0, "delay of the broadcasts, steps"),
        (120, 3, 0.0, "over: delay of the broadcasts, steps"),
    ]


def late(step: int, robot: int, probability: float, most: int) -> int:
    """Return by how many steps broadcasts come late, by the draws as they are documented."""

    def draw(text: str) -> float:
        digest = hashlib.blake2b(f"1:{step}:{robot}:{text}".encode(), digest_size=8).digest()
        return (int.from_bytes(digest, "big") >> 11) / 2**53

    return 1 + int(draw("late") * most) if draw("reordering") < probability else 0


def test_reordering() -> None:
    """A robot acts on the newest broadcasts that have come, with its own state of the step, and never goes back."""
    run = run_with("kind: reordering, probability: 0.6, steps: 4", duration="2")
    ages = set()
    for robot, k, before, after in pairs(run):
        come = [s for s in range(k + 1) if s + late(s, robot, 0.6, 4) <= k]
        used = (command_for(before, run, max(come)), max(come)) if come else (0.0, NEVER)
        assert (after.command, after.broadcast_step) == used
        ages |= {k - max(come)} if come else set()
    assert ages == {0, 1, 2, 3, 4}


def test_a_wrong_clock_shows_in_stamps_alone() -> None:
    """Stamps of the robot's states and events are off; the bag's times are not, and nobody goes astray."""
    fault = (
        "kind: clock_offset, agent: 3, offset: -0.25, from: 0.1, to: 0.2}, {kind: loss, probability: 0.1, agents: [3]"
    )
    run, usual = run_with(fault, duration="0.4"), run_with("kind: loss, probability: 0.1, agents: [3]", duration="0.4")
    for step in run.steps:
        assert {time for _, time, _ in step.stored()} == {10_000_000 * step.step}
        for record in step.records:
            off = -250_000_000 if record.agent_id == 3 and 10 <= step.step < 20 else 0
            assert record.message.stamp == 10_000_000 * step.step + off
    assert {e.step for e in run.events()} == {0, 10, 20}
    assert run.agent(3)[10].stamp == -150_000_000
    for kind in (PlaneState, AbstractState, DesiredAbstractState):
        assert run.of(kind) == usual.of(kind)
    assert [s._replace(stamp=0) for s in run.of(AgentState)] == [s._replace(stamp=0) for s in usual.of(AgentState)]
    assert run.digest() != usual.digest()
    every = ", ".join(f"{{kind: clock_offset, agent: {robot}, offset: 5}}" for robot in (1, 2, 3, 4))
    arrays = simulate(builtin("pd_het_4", "duration=0.1", f"faults=[{every}]"))
    assert arrays.time.tolist() == [0.01 * k for k in range(11)]


def test_a_liar_deceives_the_observer_and_not_the_plane() -> None:
    """The sums go by what it says, the plane by where it is and what it weighs, and so does its own law."""
    lie = "position_offset: 0.02, position_factor: 1.25, mass_factor: 0.5"
    run = run_with(f"kind: lie, agent: 3, {lie}, from: 0.5, to: 1", duration="1.5")
    said, drive = run.agent(3), DoubleIntegratorDrive.of(0.01, 0.6762, 0.6524)
    position, velocity = 0.125, 0.0
    plane = Parent(configure.parent_config(builtin("pd_het_4", "duration=1.5")))
    gap = 0.0
    for k in range(151):
        lying = 50 <= k < 100
        assert said[k].mass == (0.6762 * 0.5 if lying else 0.6762)
        assert said[k].position == (position * 1.25 + 0.02 if lying else position)
        assert_sums(run, k)
        true = said[k]._replace(mass=0.6762, position=position)
        answers = [a for s in (*run.states(k)[:2], true, run.states(k)[3]) for a in plane.handle(s)]
        (state,) = [a for a in answers if isinstance(a, PlaneState)]
        gap = max(gap, abs(state.angle - run.one(PlaneState, k).angle))
        if k < 150:
            command = command_for(true, run, k)
            assert said[k + 1].command == command
            position, velocity = drive.advance(position, velocity, command)
    assert gap < 1e-14


def test_a_robot_whose_drive_has_failed_coasts_and_reports_its_last_state() -> None:
    run = run_with("kind: drive_failure, agent: 3, from: 0.1", duration="1.5")
    said, drive = run.agent(3), DoubleIntegratorDrive.of(0.01, 0.6762, 0.6524)
    plane = Parent(configure.parent_config(builtin("pd_het_4", "duration=1.5")))
    position, velocity = said[10].position, said[10].velocity
    assert abs(velocity) > 0.01
    for k in range(151):
        true = said[k]
        if k > 10:
            assert (true.position, true.velocity, true.status) == (said[10].position, said[10].velocity, Status.ACTIVE)
            position, velocity = drive.advance(position, velocity, 0.0)
            true = true._replace(position=position, velocity=velocity)
        answers = [a for s in (*run.states(k)[:2], true, run.states(k)[3]) for a in plane.handle(s)]
        (state,) = [a for a in answers if isinstance(a, PlaneState)]
        assert state.angle == pytest.approx(run.one(PlaneState, k).angle, abs=1e-14)
    assert abs(position - said[10].position) > 0.005


def test_faults_of_a_robot_that_joins_later() -> None:
    run = run_with("at: 0.5, kind: join, agent: 2}, {kind: loss, probability: 0.1, from: 0.2, to: 0.8", duration="1")
    told = [(e.step, e.agent_id, e.value) for e in run.events() if e.kind == EventKind.FAULT_INJECTED]
    begin, end = [(20, robot, 0.1) for robot in (1, 3, 4)], [(80, robot, 0.0) for robot in (1, 2, 3, 4)]
    assert sorted(told) == sorted([*begin, (50, 2, 0.1), *end])


@cache
def undisturbed(name: str) -> RunArrays:
    return simulate(builtin(name, "duration=4"))


ALL_FOUR_ROBOT_SCENARIOS = [
    pytest.param(name, marks=() if name == "arise_het_4" else pytest.mark.full) for name in FOUR_ROBOT_SCENARIOS
]


@pytest.mark.parametrize("fault", ["kind: delay, steps: 1", "kind: delay, steps: 2", "kind: loss, probability: 0.5"])
@pytest.mark.parametrize("name", ALL_FOUR_ROBOT_SCENARIOS)
def test_delay_and_loss_are_borne(fault: str, name: str) -> None:
    """One or two samples of delay or 50 % loss change the angle by less than 8e-3 rad."""
    disturbed = simulate(builtin(name, "duration=4", f"faults=[{{{fault}}}]"))
    assert 0.0 < abs(disturbed.angle - undisturbed(name).angle).max() < 8e-3


@pytest.mark.parametrize("robot", [pytest.param(1, marks=pytest.mark.full), 3])
@pytest.mark.parametrize("kind", ["kill", "leave", "join"])
@pytest.mark.parametrize("name", ALL_FOUR_ROBOT_SCENARIOS)
def test_swarm_recovers_from_a_robot_lost_or_come(kind: str, name: str, robot: int) -> None:
    """A robot that dies, leaves or joins at 10 s is a jolt; within 4.1 s the error is below 0.01 rad for good."""
    scenario = builtin(name, "duration=18", f"faults=[{{at: 10, kind: {kind}, agent: {robot}}}]")
    law, run = configure.parent_controller(scenario), simulate(scenario)
    error = abs(np.array([law.reference(time) for time in run.time]) - run.angle)
    assert error[1410:].max() < 0.01
