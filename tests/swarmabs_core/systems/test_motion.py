"""Sums over a swarm, the parent's motion and the desired state, against continuous solutions and differences."""

from collections.abc import Callable, Sequence
from math import exp

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.swarmabs_core.helpers import Array
from tests.swarmabs_core.systems.helpers import PERIOD, jacobians, random_states

from swarmabs_core.errors import RunError
from swarmabs_core.messages import EventKind, ParentState, RobotState, Status
from swarmabs_core.systems.desired import SystemDesiredState
from swarmabs_core.systems.interface import NamedSystem
from swarmabs_core.systems.law import SystemGains
from swarmabs_core.systems.motion import ParentMotion, standing
from swarmabs_core.systems.swarm import observed

pytestmark = pytest.mark.usefixtures("systems")
Path = Callable[[float], tuple[Array, Array]]
"""Coordinates and velocities by time."""


def test_sums_do_not_depend_on_the_order_and_are_those_of_their_definitions() -> None:
    system = NamedSystem("sheet")
    states = random_states(system, 9, "double_integrator")
    states[3] = states[3]._replace(status=Status.SAFE_STOP)
    abstract, auxiliary = observed(system, 7, 3, states, curvature=True)
    assert observed(system, 7, 3, states[4:] + states[:4], curvature=True) == (abstract, auxiliary)
    m, (x, y), (u, v) = (
        np.array([s.constants[0] for s in states]),
        np.array([s.coordinates for s in states]).T,
        np.array([s.velocities for s in states]).T,
    )
    assert abstract.value == pytest.approx(
        [9.81 * m @ x, 9.81 * m @ y, m @ (x * x), m @ (y * y), m @ (x * y)], rel=1e-13
    )
    rate = [9.81 * m @ u, 9.81 * m @ v, 2 * m @ (x * u), 2 * m @ (y * v), m @ (x * v + y * u)]
    assert abstract.rate == pytest.approx(rate, rel=1e-12)
    assert auxiliary.curvature == pytest.approx(
        [0, 0, 2 * m @ (u * u), 2 * m @ (v * v), 2 * m @ (u * v)], rel=1e-9, abs=1e-12
    )
    still = [s for s in states if s.status != Status.ACTIVE]
    assert auxiliary.drift == pytest.approx(jacobians(system, still)[0] @ still[0].velocities)
    active = [s for s in states if s.status == Status.ACTIVE]
    gram = sum(j @ j.T / s.constants[0] for j, s in zip(jacobians(system, active), active, strict=True))
    assert auxiliary.gram == pytest.approx(gram[np.tril_indices(5)], rel=1e-12)  # type: ignore[index]
    assert (abstract.agent_count, abstract.stamp, abstract.step, abstract.system) == (9, 7, 3, system.hash)
    assert observed(system, 7, 3, states, curvature=False)[1].curvature == ()
    assert observed(system, 7, 3, [], curvature=True)[1].gram == (0.0,) * 15


def straight(state: RobotState) -> Path:
    q, v = np.array(state.coordinates), np.array(state.velocities)
    return lambda t: (q + t * v, v)


def pushed(state: RobotState) -> Path:
    """Return the path of a double integrator without damping under a force."""
    q, v, a = np.array(state.coordinates), np.array(state.velocities), 3.0
    return lambda t: (q + t * v + 0.5 * a * t * t, v + a * t)


def lagging(state: RobotState, time_constant: float = 0.08) -> Path:
    q, u = np.array(state.coordinates), np.array([0.5])

    def path(time: float) -> tuple[Array, Array]:
        gap = (q - u) * exp(-time / time_constant)
        return u + gap, -gap / time_constant

    return path


def exact(system: NamedSystem, states: Sequence[RobotState], paths: Sequence[Path], period: float) -> Array:
    """Return the parent's state after a period while the robots follow paths."""

    def derivative(time: float, x: Array) -> tuple[float, ...]:
        now = [path(time) for path in paths]
        a = np.sum(
            [system.instance.contribution(tuple(q), s.constants) for s, (q, _) in zip(states, now, strict=True)], 0
        )
        b = [
            np.array(system.instance.jacobian(tuple(q), s.constants)) @ v for s, (q, v) in zip(states, now, strict=True)
        ]
        return system.instance.derivative(time, tuple(x), tuple(a), tuple(np.sum(b, axis=0)))

    solved = solve_ivp(derivative, (0.0, period), (0.15, 0.3), method="DOP853", rtol=1e-13, atol=1e-15)
    return np.array(solved.y[:, -1])


def advanced(
    system: NamedSystem, states: Sequence[RobotState], paths: Sequence[Path], period: float
) -> tuple[float, ...]:
    ends = [
        s._replace(coordinates=tuple(q.tolist()), velocities=tuple(v.tolist()), command=(0.5,))
        for s, (q, v) in zip(states, (path(period) for path in paths), strict=True)
    ]
    return ParentMotion(system, period).advance(0.0, (0.15, 0.3), list(zip(states, ends, strict=True)))


@pytest.mark.parametrize(
    ("kind", "path", "least"),
    [("single_integrator", straight, 0.0), ("double_integrator", pushed, 3.5), ("first_order_lag", lagging, 3.5)],
)
def test_the_parent_moves_as_under_the_continuous_motion_of_the_robots(
    kind: str, path: Callable[[RobotState], Path], least: float
) -> None:
    system = NamedSystem("beam")
    states = [s._replace(constants=(s.constants[0], 0.0, 0.08)) for s in random_states(system, 5, kind)]
    paths = [path(state) for state in states]
    errors = []
    for period in (0.016, 0.008):
        difference = np.abs(advanced(system, states, paths, period) - exact(system, states, paths, period))
        errors.append(float(difference.max()))
    if least:
        assert errors[0] < 1e-6
        assert np.log2(errors[0] / errors[1]) > least, "the cubic is of fourth order"
    else:
        assert errors[0] < 1e-11, "the cubic is exact, Runge-Kutta steps of 2 ms remain"


def test_robots_at_rest_and_disturbances_act_on_the_parent() -> None:
    system = NamedSystem("beam", {"stiffness": 7.0})
    (state,) = random_states(system, 1, "double_integrator")
    motion = ParentMotion(system, PERIOD)
    pairs = [(state, standing(state))]
    still: Path = lambda _: (np.array(state.coordinates), np.zeros(1))  # noqa: E731
    assert motion.advance(0.0, (0.15, 0.3), pairs) == pytest.approx(exact(system, [state], [still], PERIOD), rel=1e-10)
    inertia = 0.8 + state.constants[0] * state.coordinates[0] ** 2
    change = motion.advance(0.0, (0.15, 0.3), pairs, 2.0)[1] - motion.advance(0.0, (0.15, 0.3), pairs)[1]
    assert change == pytest.approx(-2.0 / inertia * PERIOD, rel=1e-2)


def test_a_motion_that_diverges_fails_the_run() -> None:
    states = random_states(NamedSystem("beam"), 2, "single_integrator")
    diverged = r"the parent's motion diverged in the period that begins at 1.5 s; reduce the substep or the gains"
    for fault, why in (
        ("derivative_nan", ""),
        ("derivative_grows", r" \(OverflowError: .* \(systems_of_tests\.py:\d+\)\)"),
    ):
        system = NamedSystem("faulty", {"fault": fault})
        with pytest.raises(RunError, match=f"^{diverged}{why}$"):
            ParentMotion(system, PERIOD).advance(1.5, (1.0, 0.0), [(s, s) for s in states])


def parent(system: NamedSystem, step: int, *state: float) -> ParentState:
    return ParentState(step * 10_000_000, step, system.hash, state)


def test_the_desired_state_is_the_completion_of_filtered_needs_with_its_means() -> None:
    system = NamedSystem("beam")
    generator = SystemDesiredState(10_000_000, system, SystemGains())
    # x'' = w^2 (u - x) - 2 w x' with w = 50/s from rest at the first command, solved by its own formula
    speeds = [0.8, -0.4, 0.1, 0.0]
    found = [generator.advance(n * 10_000_000, parent(system, n, 0.1, w))[1] for n, w in enumerate(speeds)]
    x, v = 2.0 * speeds[0], 0.0
    for n, w in enumerate(speeds):
        c1 = x - 2.0 * w
        c2 = v + 50.0 * c1
        decay = exp(-50.0 * PERIOD)
        x1 = 2.0 * w + (c1 + c2 * PERIOD) * decay
        v1 = (c2 - 50.0 * (c1 + c2 * PERIOD)) * decay
        one, a = found[n], 0.0125
        assert one.value == pytest.approx((x, a * x * x + 0.025), rel=1e-12)
        assert one.rate == pytest.approx((v, 2.0 * a * x * v), rel=1e-9, abs=1e-12)
        assert one.end_rate == pytest.approx((v1, 2.0 * a * x1 * v1), rel=1e-9)
        assert one.mean_rate == pytest.approx(((x1 - x) / PERIOD, a * (x1 * x1 - x * x) / PERIOD), rel=1e-9, abs=1e-12)
        mean = (v1 - v) / PERIOD, 2.0 * a * (x1 * v1 - x * v) / PERIOD
        assert one.mean_acceleration == pytest.approx(mean, rel=1e-8, abs=1e-9)
        assert (one.step, one.stamp, one.system) == (n, n * 10_000_000, system.hash)
        x, v = x1, v1


def test_limited_needs_are_reported_where_the_limit_begins_to_act() -> None:
    system = NamedSystem("beam", {"added": 10.0})
    generator = SystemDesiredState(10_000_000, system, SystemGains())
    speeds = (0.1, 0.6, 0.7, 0.2, -0.9)
    found = [generator.advance(n * 10_000_000, parent(system, n, 0.1, w)) for n, w in enumerate(speeds)]
    events = [event for events, _ in found for event in events]
    assert [(e.step, e.kind, e.value, e.detail, e.agent_id) for e in events] == [
        (1, EventKind.LIMIT_HIT, 6.0, "torque limited", 0),
        (4, EventKind.LIMIT_HIT, -9.0, "torque limited", 0),
    ]
    assert max(abs(desired.value[0]) for _, desired in found) <= 5.0


def test_the_reference_can_be_offset() -> None:
    system = NamedSystem("beam")
    generator = SystemDesiredState(10_000_000, system, SystemGains())
    assert not generator.no_offset
    assert SystemDesiredState(10_000_000, NamedSystem("sheet"), SystemGains()).no_offset
    _, one = generator.advance(0, parent(system, 0, 0.0, 0.5), offset=0.1)
    assert one.value[0] == pytest.approx(2.0 * 0.5 - 5.0 * 0.1)


def test_a_failed_parent_and_needs_that_are_no_numbers_end_the_run() -> None:
    system = NamedSystem("beam", {"hit": 0.2})
    generator = SystemDesiredState(10_000_000, system, SystemGains())
    generator.advance(0, parent(system, 0, 0.19, 0.0))
    with pytest.raises(RunError, match=r"^step 1: the beam hit the ground$"):
        generator.advance(10_000_000, parent(system, 1, 0.21, 0.0))
    with pytest.raises(RunError, match=r"step 0: the controller of beam returned \(nan,\); it must return torque"):
        SystemDesiredState(10_000_000, NamedSystem("beam"), SystemGains()).advance(
            0, parent(system, 0, 0.0, float("nan"))
        )
