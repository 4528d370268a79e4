from collections.abc import Iterable, Sequence
from itertools import permutations
from math import inf, nan, sin
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from tests.swarmabs_core.helpers import PERIOD_NS, broadcasts

from swarmabs_core import messages as msg
from swarmabs_core.behaviours import Agent, AgentGroup
from swarmabs_core.behaviours.base import ConflictError, UnexpectedMessageError
from swarmabs_core.drive import DoubleIntegratorDrive
from swarmabs_core.membership import UNPLANNED, ChangeKind
from swarmabs_core.models import AgentConfig
from swarmabs_core.robot_controller import Limits
from swarmabs_core.sensing import RobotSensor
from swarmabs_core.settings import LifeSpan
from swarmabs_core.swarm_law import SwarmGains, double_integrator_command, single_integrator_command

SI, DI = msg.Kind.SINGLE_INTEGRATOR, msg.Kind.DOUBLE_INTEGRATOR
GAINS = SwarmGains((10.0, 9.0), (8.0, 7.0), (5.0, 4.0), 1.0)
MASS, DAMPING, H = 0.4, 0.7, PERIOD_NS / 1e9
kinds = pytest.mark.parametrize("kind", [SI, DI])


def config(kind: msg.Kind = SI, **settings: Any) -> AgentConfig:
    double = {"velocity": 0.05, "damping": DAMPING} if kind is DI else {}
    given = {"agent_id": 3, "kind": kind, "mass": MASS, "position": 0.12, "gains": GAINS, "period_ns": PERIOD_NS}
    return AgentConfig(**{"gravity": 9.81, "plane_length": 1.0, **given, **double, **settings})


def started(kind: msg.Kind = SI, **settings: Any) -> tuple[Agent, msg.AgentState]:
    node = Agent(config(kind, **settings))
    return node, state(node.start())


def hear(node: Agent | AgentGroup, messages: Iterable[msg.Message]) -> list[msg.Message]:
    return [answer for message in messages for answer in node.handle(message)]


def state(answers: Sequence[msg.Message]) -> msg.AgentState:
    """Return the robot's state, which comes last."""
    assert isinstance(answers[-1], msg.AgentState)
    return answers[-1]


def events(answers: Iterable[msg.Message]) -> list[tuple[int, int, msg.EventKind, str]]:
    found = [m for m in answers if isinstance(m, msg.SwarmEvent)]
    return [(e.step, e.agent_id, msg.EventKind(e.kind), e.detail) for e in found]


def law(before: msg.AgentState, heard_step: int | None = None, **wish: Any) -> float:
    """Return the command that the law asks of a robot in a given state, by broadcasts of the same or another step."""
    shared = (GAINS, 9.81, *broadcasts(before.step if heard_step is None else heard_step, **wish))
    if before.kind == SI:
        return single_integrator_command(MASS, before.position, *shared)
    return double_integrator_command(MASS, DAMPING, before.position, before.velocity, *shared)


def advanced(before: msg.AgentState, command: float, force: float = 0.0) -> tuple[float, float]:
    if before.kind == SI:
        return before.position + H * command, command
    drive = DoubleIntegratorDrive.of(H, MASS, DAMPING)
    return drive.advance(before.position, before.velocity, command + force)


def test_first_state_is_the_configured_one_and_a_robot_listens_to_no_other() -> None:
    expected = msg.AgentState(0, 0, msg.NEVER, 3, DI, msg.Status.ACTIVE, MASS, DAMPING, 0.12, 0.05, 0.0)
    assert Agent(config(DI)).start() == (expected,)
    three = (msg.DESIRED_ABSTRACT_STATE, msg.ABSTRACT_STATE, msg.AUXILIARY_STATE)
    assert Agent(config(SI)).needs == Agent(config(DI)).needs == Agent(config(SI, feels_gravity=True)).needs == three
    assert Agent(config(DI, feels_gravity=True)).needs == (*three, msg.PLANE_STATE)


@kinds
def test_follows_the_law_and_its_drive(kind: msg.Kind) -> None:
    node, before = started(kind)
    for step in range(5):
        wish = {"desired": 0.2 + 0.01 * step}
        (after,) = hear(node, broadcasts(step, **wish))
        command = law(before, **wish)
        moved = advanced(before, command)
        assert after == msg.AgentState((step + 1) * PERIOD_NS, step + 1, step, *before[3:8], *moved, command)
        before = state([after])


@kinds
def test_another_drive_moves_the_robot_by_the_same_law(kind: msg.Kind) -> None:
    class Belt:
        """Carries whatever stands on it, whatever is commanded."""

        def advance(self, position: float, velocity: float, command: float) -> tuple[float, float]:
            return position + 0.5, 0.25

    node = Agent(config(kind), config(kind).body(Belt()))
    before = state(node.start())
    after = state(hear(node, broadcasts()))
    assert (after.position, after.velocity) == (before.position + 0.5, 0.25)
    assert after.command == law(before) != 0.0


def test_acts_on_the_complete_set_of_a_step_in_any_order() -> None:
    expected = hear(started()[0], broadcasts())
    for order in permutations(broadcasts()):
        node, _ = started()
        assert hear(node, [*order[:2], *order[:2], *broadcasts(1), *broadcasts(2)[2:]]) == []
        assert node.missing() == (0, (node.awaits()[0].name,))
        with pytest.raises(
            ConflictError, match=f"{msg.TOPIC_OF[type(order[0])].name}: two different messages of step 0"
        ):
            node.handle(order[0]._replace(stamp=1))
        with pytest.raises(UnexpectedMessageError, match="agent 3: received PlaneState"):
            node.handle(msg.PlaneState(0, 0, 0.0, 0.0))
        assert list(node.handle(order[2])) == expected
        assert node.missing()[0] == 1
        assert hear(node, [order[2], *broadcasts(0, desired=3.0)]) == []


@kinds
@pytest.mark.parametrize(
    ("wish", "reason"),
    [
        ({"desired": nan}, "the law gives no finite command"),
        ({"torque": inf}, "the law gives no finite command"),
        ({"s3": nan}, "the law gives no finite command"),
    ],
)
def test_safe_stop_and_recovery(kind: msg.Kind, wish: dict[str, float], reason: str) -> None:
    node, _ = started(kind)
    before = state(hear(node, broadcasts(0)))
    answers = hear(node, broadcasts(1, **wish))
    stopped = state(answers)
    assert events(answers) == [(2, 3, msg.EventKind.SAFE_STOP, reason)]
    assert (stopped.status, stopped.broadcast_step) == (msg.Status.SAFE_STOP, msg.NEVER)
    assert stopped.command == (0.0 if kind is SI else pytest.approx(-MASS * before.velocity / 0.1))
    assert (stopped.position, stopped.velocity) == advanced(before, stopped.command)
    assert events(hear(node, broadcasts(2, **wish))) == []
    answers = hear(node, broadcasts(3))
    assert events(answers) == [(4, 3, msg.EventKind.RECOVERED, "")]
    assert (state(answers).status, state(answers).broadcast_step) == (msg.Status.ACTIVE, 3)


@kinds
def test_commanded_stop_is_latched_until_a_reset(kind: msg.Kind) -> None:
    node, _ = started(kind)
    assert events(hear(node, broadcasts(0, mode=msg.Mode.STOP))) == [(1, 3, msg.EventKind.SAFE_STOP, "stop commanded")]
    for step, mode in enumerate((*[msg.Mode.RUN] * 3, msg.Mode.RESET), start=1):  # a reset stops by itself as well
        (stopped,) = hear(node, broadcasts(step, mode=mode))
        assert (state([stopped]).status, state([stopped]).broadcast_step) == (msg.Status.SAFE_STOP, msg.NEVER)
    assert events(hear(node, broadcasts(5))) == [(6, 3, msg.EventKind.RECOVERED, "")]


@pytest.mark.parametrize(("kind", "limits"), [(SI, Limits(velocity=0.01)), (DI, Limits(force=0.02))])
@pytest.mark.parametrize("desired", [2.0, -2.0])
def test_command_is_limited_and_that_is_told_once(kind: msg.Kind, limits: Limits, desired: float) -> None:
    node, before = started(kind, limits=limits)
    wanted = law(before, desired=desired)
    bound = min(limits.velocity, limits.force)
    assert abs(wanted) > bound
    answers = hear(node, broadcasts(0, desired=desired))
    assert state(answers).command == (bound if wanted > 0 else -bound)
    (event,) = (m for m in answers if isinstance(m, msg.SwarmEvent))
    assert (event.step, event.kind, event.value) == (1, msg.EventKind.LIMIT_HIT, wanted)
    assert events(hear(node, broadcasts(1, desired=desired))) == []
    free, _ = started(kind, limits=Limits(velocity=1e6, force=1e6))
    assert hear(free, broadcasts()) == hear(started(kind)[0], broadcasts()), "within the limits it is untouched"


def test_limits_are_over_once_they_have_not_acted_for_half_a_second() -> None:
    node, before = started(limits=Limits(velocity=0.5 * abs(law(state(Agent(config()).start()), desired=2.0))))
    assert abs(law(before, desired=2.0)) > abs(law(before))
    assert events(hear(node, broadcasts(0, desired=2.0)))[0][2] == msg.EventKind.LIMIT_HIT
    told = {step: events(hear(node, broadcasts(step))) for step in range(1, 53)}
    assert {step: said for step, said in told.items() if said} == {
        50: [(51, 3, msg.EventKind.RECOVERED, "command within its limits")]
    }


def test_double_integrator_keeps_the_speed_limit_and_brakes_within_the_limit_of_force() -> None:
    node, _ = started(DI, velocity=0.09, limits=Limits(velocity=0.1))
    speeds = [abs(state(hear(node, broadcasts(step, desired=9.0))).velocity) for step in range(20)]
    assert max(speeds) == pytest.approx(0.1, rel=1e-12)
    fast, _ = started(DI, velocity=2.0, limits=Limits(velocity=0.1, force=0.5))
    assert state(hear(fast, broadcasts())).command == -0.5, "one that is far too fast brakes with what it has"
    for sign in (1.0, -1.0):
        node, _ = started(DI, velocity=sign * 0.8, limits=Limits(force=0.5))
        assert state(hear(node, broadcasts(mode=msg.Mode.STOP))).command == pytest.approx(-0.5 * sign)


@kinds
def test_decides_by_what_it_measures_and_moves_in_truth(kind: msg.Kind) -> None:
    sensor = RobotSensor((0.02, 0.05), (0.003, 0.0))
    node, before = started(kind, sensor=sensor, seed=5)
    for step in range(20):
        position, velocity = sensor.measure(before.position, before.velocity, f"5:{step}:3")
        after = state(hear(node, broadcasts(step)))
        assert after.command == law(before._replace(position=position, velocity=velocity))
        assert (after.position, after.velocity) == advanced(before, after.command)
        before = after


@kinds
def test_lag_delays_what_the_drive_does_and_not_what_it_is_told(kind: msg.Kind) -> None:
    lag = 0.03
    node, before = started(kind, actuator_lag=lag)
    if kind is SI:
        system, known = [[0, 1, 0], [0, -1 / lag, 1 / lag], [0, 0, 0]], [0.12, 0.0]
    else:
        system = [[0, 1, 0, 0], [0, -DAMPING / MASS, 1 / MASS, 0], [0, 0, -1 / lag, 1 / lag], [0, 0, 0, 0]]
        known = [0.12, 0.05, 0.0]
    for step in range(50):
        command = law(before._replace(position=known[0], velocity=known[1]))
        known = (expm(np.array(system) * H) @ [*known, command])[:-1].tolist()
        before = state(hear(node, broadcasts(step)))
        assert before.command == pytest.approx(command, rel=1e-9)
        assert (before.position, before.velocity) == pytest.approx(tuple(known[:2]), rel=1e-9)


def test_weight_acts_at_once_and_the_command_late() -> None:
    """On a steep plane a robot with a very slow drive slides as if it had none."""
    node, before = started(DI, actuator_lag=1e9, feels_gravity=True)
    after = state(hear(node, (*broadcasts(0), msg.PlaneState(0, 0, 0.5, 0.0))))
    slid = advanced(before, -MASS * 9.81 * sin(0.5))
    assert (after.position, after.velocity) == pytest.approx(slid, rel=1e-7)


def test_newcomers_wait_for_the_step_before_their_first_or_for_the_order_that_adds_them() -> None:
    node = Agent(config(life=LifeSpan(first_step=5)))
    assert node.start() == ()
    assert node.missing()[0] == 4
    for step in range(4):
        assert hear(node, broadcasts(step)) == []
    first = state(hear(node, broadcasts(4)))
    assert first == msg.AgentState(5 * PERIOD_NS, 5, msg.NEVER, 3, SI, msg.Status.ACTIVE, MASS, 0.0, 0.12, 0.0, 0.0)
    second = state(hear(node, broadcasts(5)))
    assert (second.step, second.broadcast_step) == (6, 5)
    assert second.command == law(first)
    node = Agent(config(life=LifeSpan(first_step=UNPLANNED)), steered=True)
    assert (node.start(), node.needs[0]) == ((), msg.STEERING)
    for order in (msg.Steering(0, 3, 1, msg.Action.ADD, 4, 0.0), msg.Steering(0, 3, 2, msg.Action.KILL, 3, 0.0)):
        assert node.handle(order) == ()
        assert (node.awaits(), node.missing()) == ((msg.STEERING,), (UNPLANNED, ()))
    assert hear(node, broadcasts(2)) == []
    node.handle(msg.Steering(0, 3, 3, msg.Action.ADD, 3, 0.0))
    node.handle(msg.Steering(0, 9, 4, msg.Action.ADD, 3, 0.0))
    assert node.missing()[0] == 2
    assert state(hear(node, broadcasts(2))).step == 3


@pytest.mark.parametrize("end", [ChangeKind.KILL, ChangeKind.FREEZE, ChangeKind.LEAVE])
def test_last_state_is_that_of_the_end_step(end: ChangeKind) -> None:
    node, _ = started(life=LifeSpan(0, end, 2))
    states = [state(hear(node, broadcasts(step))) for step in range(2)]
    left = msg.Status.LEFT if end is ChangeKind.LEAVE else msg.Status.ACTIVE
    assert [(s.step, s.status) for s in states] == [(1, msg.Status.ACTIVE), (2, left)]
    assert (hear(node, broadcasts(2)), node.awaits(), hear(node, broadcasts(3))) == ([], (), [])


def test_a_group_does_what_its_robots_do() -> None:
    configs = [config(SI), config(DI, agent_id=5, feels_gravity=True, last_step=1)]
    group, alone = AgentGroup([Agent(each) for each in configs]), [Agent(each) for each in configs]
    assert group.needs == alone[1].needs
    assert group.start() == tuple(state(each.start()) for each in alone)
    for step in range(3):
        heard = (*broadcasts(step), msg.PlaneState(step * PERIOD_NS, step, 0.1, 0.2))
        assert group.missing() == min(each.missing() for each in alone if each.awaits())
        assert group.awaits() == (msg.DESIRED_ABSTRACT_STATE,)
        expected = [a for m in heard for each in alone if msg.TOPIC_OF[type(m)] in each.needs for a in each.handle(m)]
        assert hear(group, heard) == expected
