"""Membership and faults in whole simulations, message by message (docs/design.md, Membership and faults)."""

from __future__ import annotations

import pytest
from tests.swarmabs_core.helpers import Run, builtin

from swarmabs_core.abstraction import Weight, abstraction, damping_sums, spread_sums
from swarmabs_core.faults import lost
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
    assert sums[2:6] == spread_sums((s.mass, s.position) for s in active)
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


def test_swarm_recovers_from_a_dead_robot_on_the_plane() -> None:
    """The others carry its weight along: the plane is level again within four seconds."""
    run = run_with("at: 5, kind: kill, agent: 1", "pd_si_4", "10")
    angles = [abs(state.angle) for state in run.of(PlaneState)]
    assert max(angles[900:]) < 0.01


@pytest.mark.parametrize("name", ["pd_het_4", "arise_di_4"])
def test_delay(name: str) -> None:
    """Broadcasts of step k - n with the robot's own state of step k; command 0 while k < n."""
    run = run_with("kind: delay, steps: 3", name, "0.5")
    for robot in (1, 4):
        states = run.agent(robot)
        for k in range(50):
            after = states[k + 1]
            if k < 3:
                assert (after.command, after.broadcast_step) == (0.0, NEVER)
            else:
                assert after.broadcast_step == k - 3
                assert after.command == command_for(states[k], run, k - 3)


def test_loss() -> None:
    """A robot that misses the broadcasts of a step keeps its command and the step on which that rests."""
    run = run_with("kind: loss, probability: 0.3", duration="2")
    missed = 0
    for robot in (1, 2, 3, 4):
        states = run.agent(robot)
        for k in range(200):
            before, after = states[k], states[k + 1]
            if lost(0.3, 1, k, robot):
                missed += 1
                assert (after.command, after.broadcast_step) == (before.command, before.broadcast_step)
            else:
                assert (after.command, after.broadcast_step) == (command_for(before, run, k), k)
    assert 180 < missed < 300


@pytest.mark.parametrize("fault", ["kind: delay, steps: 2", "kind: loss, probability: 0.5"])
@pytest.mark.parametrize("name", ["pd_si_4", "pd_di_4", "pd_het_4"])
def test_delay_and_loss_are_borne(fault: str, name: str) -> None:
    """Two samples of delay or 50 % loss change the angle by less than 8e-3 rad."""
    disturbed, undisturbed = run_with(fault, name, "6"), Run(builtin(name, "duration=6"))
    difference = disturbed.column(PlaneState, "angle") - undisturbed.column(PlaneState, "angle")
    assert abs(difference).max() < 8e-3


def test_steps_of_broadcasts_without_faults() -> None:
    run = Run(builtin("pd_het_4", "duration=0.2"))
    for state in run.of(AgentState):
        assert state.broadcast_step == (state.step - 1 if state.step else NEVER)
