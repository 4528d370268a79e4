from __future__ import annotations

from itertools import permutations
from math import inf, nan, sin
from typing import TYPE_CHECKING, Any

import pytest
from tests.swarmabs_core.helpers import PERIOD_NS, broadcasts

from swarmabs_core.behaviours import Agent, AgentConfig, LifeSpan, Limits
from swarmabs_core.behaviours.base import ConflictError, UnexpectedMessageError
from swarmabs_core.drive import DoubleIntegratorDrive
from swarmabs_core.faults import DelayFault, InjectedFault, LossFault
from swarmabs_core.membership import ChangeKind
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AUXILIARY_STATE,
    DESIRED_ABSTRACT_STATE,
    NEVER,
    PLANE_STATE,
    AgentState,
    EventKind,
    Kind,
    Message,
    Mode,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.swarm_law import SwarmGains, double_integrator_command, single_integrator_command

if TYPE_CHECKING:
    from collections.abc import Iterable

SI, DI = Kind.SINGLE_INTEGRATOR, Kind.DOUBLE_INTEGRATOR
GAINS = SwarmGains((10.0, 9.0), (8.0, 7.0), (5.0, 4.0), 1.0)
MASS, DAMPING = 0.4, 0.7
kinds = pytest.mark.parametrize("kind", [SI, DI])


def agent(kind: Kind = SI, **settings: Any) -> Agent:
    given = {
        "agent_id": 3,
        "kind": kind,
        "mass": MASS,
        "position": 0.12,
        "velocity": 0.05 if kind is DI else 0.0,
        "gains": GAINS,
        "period_ns": PERIOD_NS,
        "gravity": 9.81,
        "plane_length": 1.0,
        "damping": DAMPING if kind is DI else 0.0,
    }
    return Agent(AgentConfig(**(given | settings)))


def hear(node: Agent, messages: Iterable[Message]) -> list[Message]:
    return [answer for message in messages for answer in node.handle(message)]


def state(answers: list[Message]) -> AgentState:
    """Return the robot's state, which comes last."""
    assert isinstance(answers[-1], AgentState)
    return answers[-1]


def events(answers: Iterable[Message]) -> list[tuple[int, int, EventKind, str]]:
    found = [m for m in answers if isinstance(m, SwarmEvent)]
    return [(e.step, e.agent_id, EventKind(e.kind), e.detail) for e in found]


def law(before: AgentState, **wish: Any) -> float:
    """Return the command that the law asks of a robot in a given state."""
    shared = (GAINS, 9.81, *broadcasts(before.step, **wish))
    if before.kind == SI:
        return single_integrator_command(MASS, before.position, *shared)
    return double_integrator_command(MASS, DAMPING, before.position, before.velocity, *shared)


def advanced(before: AgentState, command: float, force: float = 0.0) -> tuple[float, float]:
    if before.kind == SI:
        return before.position + PERIOD_NS / 1e9 * command, command
    drive = DoubleIntegratorDrive.of(PERIOD_NS / 1e9, MASS, DAMPING)
    return drive.advance(before.position, before.velocity, command + force)


def test_first_state_is_the_configured_one() -> None:
    (first,) = agent(DI).start()
    assert first == AgentState(0, 0, NEVER, 3, DI, Status.ACTIVE, MASS, DAMPING, 0.12, 0.05, 0.0)


def test_listens_to_the_three_broadcasts_alone() -> None:
    three = {DESIRED_ABSTRACT_STATE, ABSTRACT_STATE, AUXILIARY_STATE}
    assert set(agent(SI).needs) == set(agent(DI).needs) == set(agent(SI, feels_gravity=True).needs) == three
    assert set(agent(DI, feels_gravity=True).needs) == three | {PLANE_STATE}


@kinds
def test_follows_the_law_and_its_drive(kind: Kind) -> None:
    node = agent(kind)
    (before,) = node.start()
    for step in range(5):
        wish = {"desired": 0.2 + 0.01 * step}
        (after,) = hear(node, broadcasts(step, **wish))
        command = law(before, **wish)
        position, velocity = advanced(before, command)
        expected = before._replace(
            stamp=(step + 1) * PERIOD_NS,
            step=step + 1,
            broadcast_step=step,
            position=position,
            velocity=velocity,
            command=command,
        )
        assert after == expected
        before = after


@kinds
def test_another_drive_moves_the_robot_by_the_same_law(kind: Kind) -> None:
    class Belt:
        """Carries whatever stands on it, whatever is commanded."""

        def advance(self, position: float, velocity: float, command: float) -> tuple[float, float]:
            return position + 0.5, 0.25

    node = Agent(agent(kind)._config, Belt())
    before = state(list(node.start()))
    after = state(hear(node, broadcasts()))
    assert (after.position, after.velocity) == (before.position + 0.5, 0.25)
    assert after.command == law(before) != 0.0


def test_the_two_laws_differ() -> None:
    commands = []
    for kind in (SI, DI):
        node = agent(kind, velocity=0.0)
        node.start()
        commands.append(state(hear(node, broadcasts())).command)
    assert abs(commands[0] - commands[1]) > 1e-3


@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_acts_on_the_complete_set_in_any_order(order: tuple[int, ...]) -> None:
    node, other = agent(), agent()
    node.start(), other.start()
    *early, last = (broadcasts()[i] for i in order)
    assert hear(node, early) == []
    assert hear(node, early) == []  # repeats
    step, (missing,) = node.missing()
    assert (step, missing) == (0, node.awaits()[0].name)
    assert node.handle(last) == tuple(hear(other, broadcasts()))
    assert node.missing()[0] == 1
    assert node.handle(last) == ()


def test_broadcasts_of_other_steps_are_ignored() -> None:
    node, other = agent(), agent()
    node.start(), other.start()
    assert hear(node, broadcasts(1)) == []
    assert hear(node, broadcasts()[:2]) == []
    assert hear(node, broadcasts(2)[2:]) == []
    assert hear(node, broadcasts()[2:]) == hear(other, broadcasts())
    assert hear(node, broadcasts(0, desired=3.0)) == []
    assert hear(node, broadcasts(1)) == hear(other, broadcasts(1))


def test_what_no_correct_peer_sends() -> None:
    node, other = agent(), agent()
    node.start(), other.start()
    node.handle(broadcasts()[0])
    with pytest.raises(ConflictError, match="swarm/abstract_state: two different messages of step 0"):
        node.handle(broadcasts(torque=0.3)[0])
    with pytest.raises(UnexpectedMessageError, match="agent 3: a PlaneState was delivered"):
        node.handle(PlaneState(0, 0, 0.0, 0.0))
    assert hear(node, broadcasts()[1:]) == hear(other, broadcasts())


def test_gravity_along_the_plane_acts_over_the_period() -> None:
    """Force -m g sin(th) + m p w^2 with the state at the beginning; the command does not know of it."""
    node = agent(DI, feels_gravity=True)
    (before,) = node.start()
    assert hear(node, broadcasts()) == []
    after = state(hear(node, [PlaneState(0, 0, 0.3, 0.5)]))
    force = MASS * (0.12 * 0.25 - 9.81 * sin(0.3))
    assert after.command == law(before)
    assert (after.position, after.velocity) == pytest.approx(advanced(before, law(before), force), rel=1e-14)


@kinds
@pytest.mark.parametrize(
    ("wish", "reason"),
    [
        ({"desired": nan}, "the law gives no finite command"),
        ({"torque": inf}, "the law gives no finite command"),
        ({"s3": 0.0}, "the swarm has no spread (S3 vanishes)"),
        ({"s3": 0.8e-12}, "the swarm has no spread (S3 vanishes)"),
        ({"s3": nan}, "the swarm has no spread (S3 vanishes)"),
    ],
)
def test_safe_stop_and_recovery(kind: Kind, wish: dict[str, float], reason: str) -> None:
    node = agent(kind)
    node.start()
    before = state(hear(node, broadcasts(0)))

    answers = hear(node, broadcasts(1, **wish))
    stopped = state(answers)
    assert events(answers) == [(2, 3, EventKind.SAFE_STOP, reason)]
    assert (stopped.status, stopped.broadcast_step) == (Status.SAFE_STOP, NEVER)
    assert stopped.command == (0.0 if kind is SI else pytest.approx(-MASS * before.velocity / 0.1))
    assert (stopped.position, stopped.velocity) == advanced(before, stopped.command)

    assert events(hear(node, broadcasts(2, **wish))) == []

    answers = hear(node, broadcasts(3))
    assert events(answers) == [(4, 3, EventKind.RECOVERED, "")]
    assert (state(answers).status, state(answers).broadcast_step) == (Status.ACTIVE, 3)


@kinds
def test_commanded_stop_is_latched(kind: Kind) -> None:
    node = agent(kind)
    node.start()
    assert events(hear(node, broadcasts(0, mode=Mode.STOP))) == [(1, 3, EventKind.SAFE_STOP, "stop commanded")]
    for step in range(1, 4):
        answers = hear(node, broadcasts(step))
        assert events(answers) == []
        assert state(answers).status == Status.SAFE_STOP
        assert state(answers).broadcast_step == NEVER


def test_brake_stops_a_double_integrator() -> None:
    node = agent(DI, velocity=0.8)
    node.start()
    speeds = [state(hear(node, broadcasts(step, mode=Mode.STOP))).velocity for step in range(100)]
    assert all(0.0 <= after < before for before, after in zip([0.8, *speeds], speeds, strict=False))
    assert speeds[-1] < 1e-4


def test_brake_respects_the_force_limit() -> None:
    for velocity in (0.8, -0.8):
        node = agent(DI, velocity=velocity, limits=Limits(force=0.5))
        node.start()
        braking = state(hear(node, broadcasts(mode=Mode.STOP)))
        assert braking.command == pytest.approx(-0.5 * velocity / 0.8)


@pytest.mark.parametrize(("kind", "limits"), [(SI, Limits(velocity=0.01)), (DI, Limits(force=0.02))])
@pytest.mark.parametrize("desired", [2.0, -2.0])
def test_command_is_limited_and_that_is_told_once(kind: Kind, limits: Limits, desired: float) -> None:
    node = agent(kind, limits=limits)
    (before,) = node.start()
    wanted = law(before, desired=desired)
    bound = min(limits.velocity, limits.force)
    assert abs(wanted) > bound
    answers = hear(node, broadcasts(0, desired=desired))
    assert state(answers).command == (bound if wanted > 0 else -bound)
    (event,) = (m for m in answers if isinstance(m, SwarmEvent))
    assert (event.step, event.kind, event.value) == (1, EventKind.LIMIT_HIT, wanted)
    assert events(hear(node, broadcasts(1, desired=desired))) == []


def test_command_within_the_limits_is_untouched() -> None:
    node, free = agent(limits=Limits(velocity=10.0, force=10.0)), agent()
    node.start(), free.start()
    assert hear(node, broadcasts()) == hear(free, broadcasts())


def test_double_integrator_keeps_the_speed_limit() -> None:
    node = agent(DI, velocity=0.09, limits=Limits(velocity=0.1))
    node.start()
    states = [state(hear(node, broadcasts(step, desired=9.0))) for step in range(20)]
    speeds = [abs(s.velocity) for s in states]
    assert max(speeds) == pytest.approx(0.1, rel=1e-12)


def test_force_limit_goes_before_the_speed_limit() -> None:
    """A robot that is far too fast brakes with what it has, and no more."""
    node = agent(DI, velocity=2.0, limits=Limits(velocity=0.1, force=0.5))
    node.start()
    assert state(hear(node, broadcasts())).command == -0.5


def test_robot_that_loses_the_broadcasts_keeps_its_command() -> None:
    node = agent(faults=(InjectedFault(LossFault(probability=0.5)),), seed=4)
    *_, before = node.start()  # its loss is announced first
    states = [state(hear(node, broadcasts(step, desired=0.1 * step))) for step in range(40)]
    losses = [LossFault(probability=0.5).loses(f"4:{step}:3") for step in range(40)]
    assert 10 < sum(losses) < 30
    for step, gone in enumerate(losses):
        new = (law(before, desired=0.1 * step), step)
        expected = (before.command, before.broadcast_step) if gone else new
        assert (states[step].command, states[step].broadcast_step) == expected
        before = states[step]


@kinds
def test_delayed_broadcasts_meet_the_robots_present_state(kind: Kind) -> None:
    node = agent(kind, faults=(InjectedFault(DelayFault(steps=2)),))
    *_, before = node.start()  # the delay is announced first
    for step in range(6):
        after = state(hear(node, broadcasts(step, desired=0.1 * step)))
        if step < 2:
            assert (after.command, after.broadcast_step) == (0.0, NEVER)
        else:
            old = broadcasts(step - 2, desired=0.1 * (step - 2))
            shared = (GAINS, 9.81, *old)
            expected = (
                single_integrator_command(MASS, before.position, *shared)
                if kind is SI
                else double_integrator_command(MASS, DAMPING, before.position, before.velocity, *shared)
            )
            assert (after.command, after.broadcast_step) == (expected, step - 2)
        before = after


def test_newcomer_waits_for_the_step_before_its_first() -> None:
    node = agent(life=LifeSpan(first_step=5))
    assert node.start() == ()
    assert node.missing()[0] == 4
    for step in range(4):
        assert hear(node, broadcasts(step)) == []
    first = state(hear(node, broadcasts(4)))
    assert first == AgentState(5 * PERIOD_NS, 5, NEVER, 3, SI, Status.ACTIVE, MASS, 0.0, 0.12, 0.0, 0.0)
    second = state(hear(node, broadcasts(5)))
    assert (second.step, second.broadcast_step) == (6, 5)
    assert second.command == law(first)


@pytest.mark.parametrize("end", [ChangeKind.KILL, ChangeKind.FREEZE, ChangeKind.LEAVE])
def test_last_state_is_that_of_the_end_step(end: ChangeKind) -> None:
    node = agent(life=LifeSpan(0, end, 2))
    node.start()
    states = [state(hear(node, broadcasts(step))) for step in range(2)]
    assert [s.step for s in states] == [1, 2]
    assert states[0].status == Status.ACTIVE
    assert states[1].status == (Status.LEFT if end is ChangeKind.LEAVE else Status.ACTIVE)
    assert hear(node, broadcasts(2)) == []
    assert node.awaits() == ()
    assert hear(node, broadcasts(3)) == []


def test_run_ends_with_its_last_step() -> None:
    node = agent(last_step=1)
    node.start()
    assert state(hear(node, broadcasts(0))).step == 1
    assert node.awaits() == (DESIRED_ABSTRACT_STATE,)
    assert hear(node, broadcasts(1)) == []
    assert node.awaits() == ()
