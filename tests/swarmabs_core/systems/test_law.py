"""The laws of robots on any parent system, against linear algebra and solutions of the robots' equations."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from tests.swarmabs_core.helpers import broadcasts
from tests.swarmabs_core.systems.helpers import (
    PERIOD,
    heard,
    jacobians,
    law,
    random_states,
    rates,
    weights,
)

from swarmabs_core.abstraction import Weight, is_degenerate, observed as plane_observed, second_moments
from swarmabs_core.messages import AgentState, DesiredAbstractState, Kind, Status, SwarmBroadcast
from swarmabs_core.swarm_law import SwarmGains, double_integrator_command, single_integrator_command
from swarmabs_core.systems.interface import NamedSystem, Quantity
from swarmabs_core.systems.law import LEAST_PIVOT, Gram, SystemGains
from swarmabs_core.systems.swarm import observed

pytestmark = pytest.mark.usefixtures("systems")
KINDS = {"beam": "single_integrator", "sheet": "single_integrator", "lift": "first_order_lag"}
GAINS = SystemGains((4.0,), (16.0,), (7.0,), 0.8)


def by_row(size: int) -> SystemGains:
    """Return different gains for each row."""
    return SystemGains(*(tuple(first + n for n in range(size)) for first in (3.0, 10.0, 5.0)), 0.8)


@pytest.mark.parametrize("count", [6, 40])
@pytest.mark.parametrize("name", KINDS)
def test_the_rate_of_the_abstract_state_is_what_the_law_wants_with_least_effort(name: str, count: int) -> None:
    system = NamedSystem(name)
    states = random_states(system, count, KINDS[name])
    size = len(system.instance.abstract)
    broadcast, gains = heard(system, states), by_row(size)
    wanted = np.array(gains.k) * (np.array(broadcast.desired.value) - broadcast.abstract.value)
    wanted += broadcast.desired.mean_rate
    found = rates(system, states, broadcast, gains)
    jacobian, weight = jacobians(system, states), weights(system, states)
    assert np.einsum("nkd,nd->k", jacobian, found) == pytest.approx(wanted, rel=1e-12, abs=1e-12)
    own = np.array([system.instance.own_motion(s.coordinates, s.constants) for s in states])
    columns = np.hstack([j / np.sqrt(w) for j, w in zip(jacobian, weight, strict=True)])
    drift = np.einsum("nkd,nd->k", jacobian, own)
    least = np.linalg.lstsq(columns, wanted - drift, rcond=None)[0].reshape(found.shape)
    assert found == pytest.approx(own + least / np.sqrt(weight)[:, None], rel=1e-9, abs=1e-11)


@pytest.mark.parametrize("name", ["beam", "sheet"])
def test_the_acceleration_of_the_abstract_state_is_what_the_law_wants(name: str) -> None:
    system = NamedSystem(name)
    states = random_states(system, 7, "double_integrator")
    size = len(system.instance.abstract)
    broadcast, gains = heard(system, states), by_row(size)
    wish, now = broadcast.desired, broadcast.abstract
    wanted = np.array(gains.kp) * (np.array(wish.value) - now.value)
    wanted += np.array(gains.kd) * (np.array(wish.rate) - now.rate) + wish.mean_acceleration
    found = rates(system, states, broadcast, gains)

    def value(time: float) -> np.ndarray:
        """Return the abstract state of robots that accelerate as the law prescribes."""
        return np.sum(
            [
                system.instance.contribution(tuple(np.array(s.coordinates) + time * (v + 0.5 * time * a)), s.constants)
                for s, v, a in zip(states, np.array([s.velocities for s in states]), found, strict=True)
            ],
            axis=0,
        )

    h = 1e-2  # of a polynomial of degree 4 in time, this combination is exact
    bend = (16.0 * (value(h) + value(-h)) - (value(2.0 * h) + value(-2.0 * h)) - 30.0 * value(0.0)) / (12.0 * h * h)
    assert bend == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_double_integrators_with_the_velocity_law_end_the_period_with_the_velocity_of_single_ones() -> None:
    system = NamedSystem("sheet")
    states = random_states(system, 6, "double_integrator")
    broadcast = heard(system, states)
    single = broadcast._replace(desired=broadcast.desired._replace(mean_rate=broadcast.desired.end_rate))
    expected = rates(system, [s._replace(kind=1) for s in states], single, GAINS)
    for state, velocity in zip(states, expected, strict=True):
        robot = law(system, state, GAINS, second_order=False)
        rate = robot.rate(state.coordinates, state.velocities, broadcast)
        assert rate is not None
        command = robot.command(state.coordinates, state.velocities, rate)
        assert robot.advance(state.coordinates, state.velocities, command)[1] == pytest.approx(
            tuple(velocity), rel=1e-12
        )


def test_robots_that_do_not_follow_the_law_are_compensated_by_the_others() -> None:
    system = NamedSystem("sheet")
    states = random_states(system, 8, "single_integrator")
    states[2] = states[2]._replace(status=Status.LIMITED)
    states[5] = states[5]._replace(status=Status.SAFE_STOP)
    broadcast = heard(system, states)
    wanted = 4.0 * (np.array(broadcast.desired.value) - broadcast.abstract.value) + broadcast.desired.mean_rate
    active = [s for s in states if s.status == Status.ACTIVE]
    others = [s for s in states if s.status != Status.ACTIVE]
    moved = np.einsum("nkd,nd->k", jacobians(system, active), rates(system, active, broadcast, GAINS))
    carried = np.einsum("nkd,nd->k", jacobians(system, others), np.array([s.velocities for s in others]))
    assert moved + carried == pytest.approx(wanted, rel=1e-12)


def test_the_gram_matrix_is_solved() -> None:
    draw = np.random.default_rng(3)
    for size in range(1, 17):
        scales = 10.0 ** draw.uniform(-3, 3, size)
        columns = draw.normal(size=(size, size + 3)) * scales[:, None]
        gram, right = columns @ columns.T, draw.normal(size=size) * scales
        found = Gram(gram[np.tril_indices(size)].tolist(), [Quantity(f"r{n}", "1", s) for n, s in enumerate(scales)])
        assert not found.uncontrolled
        solved = np.linalg.solve(gram / np.outer(scales, scales), right / scales) / scales
        assert found.solve(right.tolist()) == pytest.approx(solved.tolist(), rel=1e-7)
        if size > 1:
            gram[-1, :] = gram[:, -1] = gram[:, 0]
            gram[-1, -1] = gram[0, 0]
            rows = [Quantity(f"r{n}", "1", s) for n, s in enumerate([*scales[:-1], scales[0]])]
            singular = Gram(gram[np.tril_indices(size)].tolist(), rows)
            assert singular.uncontrolled == [size - 1], "the last row is the one that is lost"
            assert singular.least < 1e-12
    assert Gram([float("nan")], [Quantity("r", "1")]).uncontrolled == [0]
    assert Gram([0.0], [Quantity("r", "1")]).empty


@pytest.mark.parametrize("share", [1e-3, 1e-6, 0.0])
def test_rows_that_robots_cannot_control_give_way_and_the_others_are_exact(share: float) -> None:
    """Their own part of the right side is met by the square of the pivot, in units of the one below which it is damped.

    Both follow from the damped matrix of numpy: S + Delta with Delta = D0^2/p - p in the place of the small pivot p.
    """
    draw, size, weak = np.random.default_rng(8), 4, 2
    columns = draw.normal(size=(size, 9))
    columns[weak] = columns[0] + columns[1]
    left = draw.normal(size=9)
    left -= columns[[0, 1]].T @ np.linalg.lstsq(columns[[0, 1]].T, left, rcond=None)[0]
    edge = LEAST_PIVOT * max(np.sum(columns * columns, axis=1))
    columns[weak] += np.sqrt(share * edge) * left / np.linalg.norm(left)
    gram, right = columns @ columns.T, draw.normal(size=size)
    y = Gram(gram[np.tril_indices(size)].tolist(), [Quantity(f"r{n}", "1") for n in range(size)]).solve(right.tolist())
    met = gram @ y
    others = [0, 1, 3]
    assert met[others] == pytest.approx(right[others], rel=1e-5)
    lacks = right[weak] - right[0] - right[1]  # what it asks for beyond the rows before, here
    assert abs(met[weak] - right[0] - right[1]) <= 1.1 * share * share * abs(lacks) + 1e-5
    # The motion itself stays below that at the edge, however small the pivot is.
    assert np.linalg.norm(columns.T @ y) < np.linalg.norm(np.linalg.pinv(columns[others]) @ right[others]) + 1.1 * abs(
        lacks
    ) / np.sqrt(edge)


def test_the_pivot_rule_is_the_planes_rule_for_s3() -> None:
    length, draw = 2.0, np.random.default_rng(4)
    rows = (Quantity("torque", "N m", 9.81), Quantity("inertia", "kg m^2", 2.0 * length))
    verdicts = []
    for _ in range(300):
        masses = draw.uniform(0.1, 1.0, 5)
        # Cancellation leaves about 1e-16 of S2, so spreads below 1e-8 L are not resolved by a sum that is not centred.
        spread = 10.0 ** draw.uniform(-6.5, -1.5)
        places = draw.uniform(-1e-3, 1e-3) + spread * draw.uniform(-1.0, 1.0, 5)
        s0, s1, s2, s3 = second_moments(zip(masses.tolist(), places.tolist(), strict=True))
        if 0.9 < s3 / (LEAST_PIVOT * s0 * s0 * length * length) < 1.1:
            continue
        gram = Gram([9.81**2 * s0, 2.0 * 9.81 * s1, 4.0 * s2], rows)
        verdicts.append(is_degenerate(s0, s3, length))
        assert (gram.least < LEAST_PIVOT) == verdicts[-1], (s3 / s0**2, spread)
    assert 50 < sum(verdicts) < 250


def test_robots_at_one_place_control_the_first_row_and_without_any_there_is_no_rate() -> None:
    system = NamedSystem("beam")
    states = [s._replace(coordinates=(0.1,)) for s in random_states(system, 4, "single_integrator")]
    broadcast = heard(system, states)
    wanted = 4.0 * (broadcast.desired.value[0] - broadcast.abstract.value[0]) + broadcast.desired.mean_rate[0]
    found = rates(system, states, broadcast, GAINS)
    assert np.einsum("nkd,nd->k", jacobians(system, states), found)[0] == pytest.approx(wanted, rel=1e-9)
    nobody = broadcast._replace(auxiliary=broadcast.auxiliary._replace(gram=(0.0, 0.0, 0.0)))
    assert law(system, states[0], GAINS).rate(*states[0][7:9], nobody) is None


@pytest.mark.parametrize("name", ["beam", "sheet", "lift"])
def test_a_robot_at_its_limit_asks_what_the_law_would_be_with_it(name: str) -> None:
    system = NamedSystem(name)
    states = random_states(system, 9, KINDS[name])
    held = tuple(0.1 for _ in states[0].coordinates)
    limited = [states[0]._replace(status=Status.LIMITED, velocities=held), *states[1:]]
    without, whole = heard(system, limited), heard(system, states)
    asked = law(system, states[0], GAINS).rate(*states[0][7:9], without, held)
    same = whole._replace(abstract=without.abstract, desired=without.desired)
    assert asked == pytest.approx(law(system, states[0], GAINS).rate(*states[0][7:9], same), rel=1e-9)


@pytest.mark.parametrize("bound", [1e-3, 1e3])
def test_the_effort_bound_scales_the_motion_of_the_whole_swarm(bound: float) -> None:
    system = NamedSystem("sheet")
    states = random_states(system, 6, "single_integrator")
    broadcast = heard(system, states)
    free = rates(system, states, broadcast, GAINS)
    effort = np.sqrt(np.sum(weights(system, states) * np.sum(free * free, axis=1)))
    assert 1e-2 < effort < 1e2
    bounded = rates(system, states, broadcast, GAINS, effort=bound)
    assert bounded == pytest.approx(free * min(1.0, bound / effort), rel=1e-12)


def test_no_effort_is_not_divided_by() -> None:
    system = NamedSystem("beam")
    states = random_states(system, 4, "single_integrator")
    still = heard(system, states)
    zero = (0.0, 0.0)
    still = still._replace(desired=still.desired._replace(value=still.abstract.value, mean_rate=zero))
    assert not rates(system, states, still, GAINS, effort=1.0).any()


def test_drives_give_the_rate_of_the_law_in_the_mean_and_move_exactly() -> None:
    system, rate = NamedSystem("beam"), (0.7,)
    for damping in (0.0, 1e-9, 0.4, 300.0):
        (state,) = random_states(system, 1, "double_integrator")
        state = state._replace(constants=(0.6, damping, 0.05))
        robot = law(system, state, GAINS)
        command = robot.command(state.coordinates, state.velocities, rate)
        position, velocity = robot.advance(state.coordinates, state.velocities, command)
        assert velocity[0] - state.velocities[0] == pytest.approx(rate[0] * PERIOD, rel=1e-9)
        held = expm(np.array([[0.0, 1.0, 0.0], [0.0, -damping / 0.6, 1.0 / 0.6], [0.0, 0.0, 0.0]]) * PERIOD)
        exact = held @ [*state.coordinates, *state.velocities, *command]
        assert (*position, *velocity) == pytest.approx(tuple(exact[:2]), rel=1e-12)
    for lag in (1e-3, 0.05, 10.0):
        (state,) = random_states(system, 1, "first_order_lag")
        state = state._replace(constants=(0.6, 0.0, lag))
        robot = law(system, state, GAINS)
        command = robot.command(state.coordinates, state.velocities, rate)
        (after,), (speed,) = robot.advance(state.coordinates, state.velocities, command)
        assert after - state.coordinates[0] == pytest.approx(rate[0] * PERIOD, rel=1e-9)
        exact = solve_ivp(
            lambda _, x, u=command[0], t=lag: (u - x) / t, (0.0, PERIOD), state.coordinates, rtol=1e-12, atol=1e-15
        )
        assert after == pytest.approx(exact.y[0, -1], rel=1e-10)
        assert speed == pytest.approx((command[0] - after) / lag)
        (held_rate,) = robot.held_rate((after,), command)
        assert held_rate == pytest.approx((robot.advance((after,), (), command)[0][0] - after) / PERIOD)


def test_brakes_stop_robots() -> None:
    system = NamedSystem("beam")
    for kind, expected in (
        ("single_integrator", 0.0),
        ("double_integrator", -0.6 * 0.3 / 0.2),
        ("first_order_lag", 0.1),
    ):
        (state,) = random_states(system, 1, kind)
        state = state._replace(constants=(0.6, 0.4, 0.05))
        (command,) = law(system, state, GAINS).brake((0.1,), (0.3,), 0.2)
        assert command == pytest.approx(expected)


def on_the_plane(kind: Kind, damping: float = 0.0) -> tuple[SwarmBroadcast, list[AgentState], tuple[object, ...]]:
    """Return a swarm on the plane with both families of broadcasts."""
    system = NamedSystem("tilting_plane")
    masses, draw = (0.35, 0.35, 0.35, 0.35, 0.35), np.random.default_rng(5)
    if kind is Kind.SINGLE_INTEGRATOR:
        masses = (0.3552, 0.3532, 0.6762, 0.4596, 0.5)
    places = draw.uniform(-0.4, 0.4, 5).tolist()
    speeds = draw.uniform(-0.3, 0.3, 5).tolist()
    robots = [
        AgentState(0, 0, 0, n + 1, kind, Status.ACTIVE, m, damping, p, v, 0.0)
        for n, (m, p, v) in enumerate(zip(masses, places, speeds, strict=True))
    ]
    loads = [Weight(s.mass, s.position, s.velocity) for s in robots]
    abstract, sums = plane_observed(0, 0, loads, robots, 9.81, 0.7)
    wish: DesiredAbstractState = broadcasts()[2]
    states = [
        s._replace(kind=kind, coordinates=(r.position,), velocities=(r.velocity,), constants=(r.mass, r.damping, 0.05))
        for s, r in zip(random_states(system, 5, kind.name.lower()), robots, strict=True)
    ]
    general = heard(system, states)
    general = general._replace(
        desired=general.desired._replace(
            value=(wish.torque, wish.inertia),
            rate=(wish.torque_rate, wish.inertia_rate),
            mean_rate=(wish.mean_torque_rate, wish.mean_inertia_rate),
            mean_acceleration=(wish.torque_acceleration, wish.inertia_acceleration),
        )
    )
    assert (abstract.torque, abstract.inertia) == pytest.approx(general.abstract.value, rel=1e-14)
    assert (abstract.torque_rate, abstract.inertia_rate) == pytest.approx(general.abstract.rate, rel=1e-13)
    assert observed(system, 0, 0, states[::-1], curvature=True)[0] == general.abstract
    return general, robots, (abstract, sums, wish, states)


def test_on_the_plane_the_law_is_that_of_the_paper() -> None:
    gains = SwarmGains((10.0, 9.0), (10.0, 8.0), (5.0, 6.0), 0.7)
    system = NamedSystem("tilting_plane")
    general, robots, (abstract, sums, wish, states) = on_the_plane(Kind.SINGLE_INTEGRATOR)
    expected = [
        single_integrator_command(r.mass, r.position, gains, 9.81, abstract, sums, wish)  # type: ignore[arg-type]
        for r in robots
    ]
    found = rates(system, states, general, SystemGains(gains.k))  # type: ignore[arg-type]
    assert found[:, 0] == pytest.approx(expected, rel=1e-11)

    # Without damping and with equal masses, k_sd is sigma times the mass, and both laws damp alike.
    general, robots, (abstract, sums, wish, states) = on_the_plane(Kind.DOUBLE_INTEGRATOR)
    expected = [
        double_integrator_command(r.mass, 0.0, r.position, r.velocity, gains, 9.81, abstract, sums, wish) / r.mass  # type: ignore[arg-type]
        for r in robots
    ]
    found = rates(system, states, general, SystemGains((1.0,), gains.kp, gains.kd, 0.7 / 0.35))  # type: ignore[arg-type]
    assert found[:, 0] == pytest.approx(expected, rel=1e-10)


def test_limits_hold_commands() -> None:
    system = NamedSystem("lift")
    (state,) = random_states(system, 1, "first_order_lag")
    robot = law(system, state._replace(constants=(0.05, 0.3, 12.0)), GAINS)
    assert robot.limited((13.0,)) == (12.0,)
    assert robot.limited((-0.1,)) == (0.0,)
    assert robot.limited((5.0,)) == (5.0,)
    free = NamedSystem("sheet")
    (state,) = random_states(free, 1, "single_integrator")
    assert law(free, state, replace(GAINS, sigma=2.0), effort=inf).limited((1e9, -1e9)) == (1e9, -1e9)
