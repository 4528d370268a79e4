from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state

from swarmabs_core import plant
from swarmabs_core.behaviours import Plane, PlaneConfig
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError, UnknownAgentError
from swarmabs_core.errors import RunError
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import (
    AGENT_STATE,
    EVENTS,
    AbstractState,
    AgentState,
    EventKind,
    Kind,
    Message,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.plant import Disturbance, Friction
from swarmabs_core.sensing import Sensor

FRICTION = Friction(0.01, 30.0, 20.0, 0.02, 30.0, 1.0)
H = PERIOD_NS / 1e9
MASS = 0.5

Array = NDArray[np.float64]
Path = tuple[float, Polynomial]
"""A robot's mass (kg) and position p(t) (m) over a period, t from 0 to `H`."""
PLANE = plant.Plane(
    inertia=0.5,
    length=1.0,
    gravity=9.81,
    friction=FRICTION,
    substep=0.001,
    angle=0.1,
    angular_velocity=-0.2,
    disturbance=Disturbance(0.3, 4.0),
)


def plane(
    *schedule: Change, members: tuple[int, ...] = (1, 2, 3), last_step: int | None = None, **options: Any
) -> Plane:
    return Plane(
        PlaneConfig(
            members=members,
            period_ns=PERIOD_NS,
            plane=replace(PLANE, **{name: options.pop(name) for name in ("end_stop", "sensor") if name in options}),
            schedule=schedule,
            last_step=last_step,
            **options,
        )
    )


def robots(step: int = 0, without: tuple[int, ...] = ()) -> list[AgentState]:
    """Two single integrators and a double integrator, moving fast."""
    moves = [
        agent_state(1, step, position=0.1 + 0.03 * step, velocity=3.0),
        agent_state(2, step, position=-0.2 + 0.02 * step, velocity=2.0),
        agent_state(3, step, kind=Kind.DOUBLE_INTEGRATOR, damping=1.0, position=0.3 - 0.01 * step, velocity=1.0 - step),
    ]
    return [state for state in moves if state.agent_id not in without]


def feed(node: Plane, messages: list[AgentState]) -> list[Message]:
    return [answer for message in messages for answer in node.handle(message)]


def angle(node: Plane, messages: list[AgentState]) -> tuple[float, float]:
    """Feed the last messages of a step and return the plane's state."""
    *_, state = feed(node, messages)
    assert isinstance(state, PlaneState)
    return state.angle, state.angular_velocity


def line(start: float, end: float) -> Polynomial:
    return Polynomial([start, (end - start) / H])


def lines(step: int) -> list[Path]:
    """Return the paths of the single integrators over the period that begins with a step."""
    ends = zip(robots(step)[:2], robots(step + 1)[:2], strict=True)
    return [(MASS, line(a.position, b.position)) for a, b in ends]


def curve(step: int) -> Path:
    """Return the cubic path of the double integrator over that period: four linear equations."""
    a, b = robots(step)[2], robots(step + 1)[2]
    conditions = [[1, 0, 0, 0], [0, 1, 0, 0], [1, H, H**2, H**3], [0, 1, 2 * H, 3 * H**2]]
    return MASS, Polynomial(np.linalg.solve(conditions, [a.position, a.velocity, b.position, b.velocity]))


def solved(start: tuple[float, float], step: int, paths: list[Path]) -> tuple[float, float]:
    """Solve one period of the plane by SciPy under robots on given paths."""

    def rhs(t: float, x: Array) -> list[float]:
        tau = 9.81 * sum(m * p(t) for m, p in paths)
        inertia = sum(m * p(t) ** 2 for m, p in paths)
        rate = 2.0 * sum(m * p(t) * p.deriv()(t) for m, p in paths)
        tau_d = 0.3 * np.sin(4.0 * (step * H + t))
        forces = -np.cos(x[0]) * tau - rate * x[1] - FRICTION.torque(x[1]) - tau_d
        return [x[1], forces / (0.5 + inertia)]

    return tuple(solve_ivp(rhs, (0.0, H), start, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1])


def test_first_state_is_the_initial_one() -> None:
    node = plane()
    assert node.start() == ()
    assert feed(node, robots()) == [PlaneState(0, 0, 0.1, -0.2)]


def test_two_periods_against_scipy() -> None:
    """Single integrators move on straight lines, double integrators on cubics."""
    node, state = plane(), (0.1, -0.2)
    feed(node, robots(0))
    for step in (0, 1):
        expected = solved(state, step, [*lines(step), curve(step)])
        state = angle(node, robots(step + 1))
        assert state == pytest.approx(expected, abs=1e-9)


arrivals = st.tuples(
    st.permutations([*robots(0), *robots(0)[:2]]), st.permutations(robots(1)), st.permutations(robots(2))
)


@given(arrivals)
def test_any_order_of_arrival_gives_the_same_bits(steps: tuple[list[AgentState], ...]) -> None:
    found, expected = plane(), plane()
    for step, arrival in enumerate(steps):
        assert feed(found, arrival) == feed(expected, robots(step))


def test_nothing_is_published_before_the_last_one() -> None:
    node = plane()
    assert feed(node, robots()[1:]) == []
    assert node.missing() == (0, ("agent 1",))
    assert node.awaits() == (AGENT_STATE, EVENTS)
    assert len(node.handle(robots()[0])) == 1


@pytest.mark.parametrize(
    ("message", "error"),
    [
        (agent_state(9), UnknownAgentError),
        (agent_state(3, 1), StepAheadError),
        (agent_state(1, position=0.3), ConflictError),
        (AbstractState(0, 0, 3, 0.0, 0.0, 0.0, 0.0), UnexpectedMessageError),
    ],
)
def test_what_no_correct_peer_sends(message: Message, error: type[Exception]) -> None:
    node = plane()
    feed(node, robots()[:2])
    with pytest.raises(error):
        node.handle(message)
    assert feed(node, robots()[2:]) == [PlaneState(0, 0, 0.1, -0.2)]


@pytest.mark.parametrize("kind", [ChangeKind.KILL, ChangeKind.FREEZE])
def test_killed_robot_stands_from_its_last_state_on(kind: ChangeKind) -> None:
    node = plane(Change(1, 3, kind))
    feed(node, robots(0))
    state = angle(node, robots(1))
    stands = (MASS, line(robots(1)[2].position, robots(1)[2].position))
    for step in (1, 2):
        expected = solved(state, step, [*lines(step), stands])
        state = angle(node, robots(step + 1, without=(3,)))
        assert state == pytest.approx(expected, abs=1e-9)


def test_robot_that_leaves_weighs_until_the_next_step() -> None:
    """It stands over the period after its last state, and is gone then."""
    node = plane()
    feed(node, robots(0))
    state = angle(node, [*robots(1)[:2], robots(1)[2]._replace(status=Status.LEFT)])
    stands = (MASS, line(robots(1)[2].position, robots(1)[2].position))
    for step, others in ((1, [stands]), (2, [])):
        expected = solved(state, step, [*lines(step), *others])
        state = angle(node, robots(step + 1, without=(3,)))
        assert state == pytest.approx(expected, abs=1e-9)


def test_newcomer_weighs_from_its_first_state_on() -> None:
    node = plane(Change(1, 3, ChangeKind.JOIN))
    feed(node, robots(0, without=(3,)))
    state = angle(node, robots(1))
    assert state == pytest.approx(solved((0.1, -0.2), 0, lines(0)), abs=1e-9)
    expected = solved(state, 1, [*lines(1), curve(1)])
    assert angle(node, robots(2)) == pytest.approx(expected, abs=1e-9)


def test_observers_word_ends_the_wait_for_a_robot() -> None:
    node, twin = plane(), plane(Change(0, 3, ChangeKind.KILL))
    assert feed(node, robots(0)) == feed(twin, robots(0))
    assert feed(node, robots(1, without=(3,))) == []
    found = node.handle(SwarmEvent(PERIOD_NS, 1, 3, EventKind.DEAD, 0.3, "no answer"))
    assert list(found) == feed(twin, robots(1, without=(3,)))


def test_an_end_before_a_state_that_the_plane_has_used_is_refused_and_any_other_is_not() -> None:
    dead = SwarmEvent(PERIOD_NS, 1, 3, EventKind.DEAD, 0.3, "silent")
    node = plane()
    feed(node, robots(0) + robots(1))
    with pytest.raises(RunError, match=r"robot 3 is said to be out from step 1 on \(silent\), and the plane has moved"):
        node.handle(dead)
    node = plane()
    feed(node, robots(0))
    with pytest.raises(StepAheadError, match=r"end of robot 3: step 1 expected, 2 received"):
        node.handle(dead._replace(step=2))
    node = plane()
    feed(node, robots(0) + robots(1, without=(1,)))
    assert node.handle(dead) == ()  # heard, but not used
    assert len(feed(node, [agent_state(1, 1), *robots(2, without=(3,))])) == 2
    assert node.handle(dead) == ()  # repeated
    assert node.handle(SwarmEvent(PERIOD_NS, 1, 2, EventKind.LIMIT_HIT, 0.3, "")) == ()


def test_end_of_the_plane_is_told_once_per_crossing() -> None:
    node = plane()
    found = []
    for step, position in enumerate((0.4, 0.5, 0.51, 0.52, 0.4, -0.6)):
        answers = feed(node, [agent_state(1, step, position=position), *robots(step)[1:]])
        found += [event for event in answers if isinstance(event, SwarmEvent)]
    assert [(e.step, e.agent_id, e.kind, e.value) for e in found] == [
        (2, 1, EventKind.LIMIT_HIT, 0.51),
        (5, 1, EventKind.LIMIT_HIT, -0.6),
    ]


def test_run_ends_with_its_last_step() -> None:
    node = plane(last_step=0)
    assert len(feed(node, robots(0))) == 1
    assert node.awaits() == ()
    assert feed(node, robots(1)) == []


def test_lagging_single_integrator_moves_on_the_cubic_through_its_states() -> None:
    """Its true path is p0 + u s + T (1 - e^(-s/T)) (v0 - u): the plane under it is solved by SciPy."""
    lag, v0, u = 0.02, 3.0, -1.0

    def moved(t: float) -> tuple[float, float]:
        gap = (v0 - u) * np.exp(-t / lag)
        return 0.1 + u * t + lag * (v0 - u - gap), u + gap

    def at(step: int) -> AgentState:
        position, velocity = moved(step * H)
        return agent_state(1, step, position=position, velocity=velocity)

    def rhs(t: float, x: Array) -> list[float]:
        p, v = moved(t)
        tau_d = 0.3 * np.sin(4.0 * t)
        forces = -np.cos(x[0]) * 9.81 * MASS * p - 2.0 * MASS * p * v * x[1] - FRICTION.torque(x[1]) - tau_d
        return [x[1], forces / (0.5 + MASS * p * p)]

    expected = solve_ivp(rhs, (0.0, H), (0.1, -0.2), "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    errors = []
    for actuator_lag in (lag, 0.0):
        node = plane(members=(1,), actuator_lag=actuator_lag)
        feed(node, [at(0)])
        errors.append(abs(np.array(angle(node, [at(1)])) - expected).max())
    assert errors[0] < 1e-6
    assert errors[1] > 20.0 * errors[0]


@pytest.mark.parametrize(("lag", "curved"), [(0.0, False), (0.24 * H, False), (0.25 * H, True), (1.0, True)])
def test_a_lag_much_shorter_than_the_period_leaves_the_path_a_line(lag: float, *, curved: bool) -> None:
    found = []
    for node in (plane(members=(1,), actuator_lag=lag), plane(members=(1,))):
        feed(node, [agent_state(1, 0, velocity=-1.0)])
        found.append(angle(node, [agent_state(1, 1, velocity=1.0)]))
    assert (found[0] != found[1]) is curved


def test_end_stop_is_announced_once() -> None:
    node = plane(members=(1,), end_stop=0.11)
    hits: list[tuple[int, float]] = []
    for step in range(120):
        position = -0.3 if step < 40 else 0.3 if step < 60 else -0.3
        answers = feed(node, [agent_state(1, step, position=position)])
        hits += [(event.step, event.value) for event in answers if isinstance(event, SwarmEvent)]
        state = answers[-1]
        assert isinstance(state, PlaneState)
        assert abs(state.angle) <= 0.11
    assert [value for _, value in hits] == [0.11, 0.11]
    assert hits[0][0] < 40
    assert hits[1][0] > 60


def test_end_stop_of_the_other_side_has_its_sign() -> None:
    node = plane(members=(1,), end_stop=0.11)
    answers = [answer for step in range(60) for answer in feed(node, [agent_state(1, step, position=0.3)])]
    (event,) = [answer for answer in answers if isinstance(answer, SwarmEvent)]
    assert (event.agent_id, event.kind, event.value) == (0, EventKind.LIMIT_HIT, -0.11)
    assert event.detail.startswith("end stop hit at 0.")


def test_what_is_published_is_measured_and_what_is_integrated_is_true() -> None:
    sensor = Sensor((0.01, 0.1), (0.001, 0.0))
    measuring, true = plane(sensor=sensor, seed=4), plane()
    for step in range(5):
        expected = sensor.measure(*angle(true, robots(step)), f"4:{step}:plane")
        assert angle(measuring, robots(step)) == expected
