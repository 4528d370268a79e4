"""The continuous-time references of the example parent systems, held to laws of mechanics and to published figures."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from examples.payload.tests.reference import Payload
from examples.plate.tests.reference import Plate
from examples.reference_tools import GRAVITY, Array, Event, Gains, Law, Loop, Robots, Solution, System
from examples.ship.tests.reference import Ship
from numpy.testing import assert_allclose
from scipy.integrate import simpson
from scipy.interpolate import make_interp_spline
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

pytestmark = pytest.mark.timeout(300)

SHIP, PLATE, PAYLOAD = Gains(5.0, 16.0, 8.0), Gains(8.0, 25.0, 10.0), Gains(20.0)
FORCE = "double_integrator"


def robots(coordinates: Array, **constants: Array) -> Robots:
    """Return velocity robots at rest."""
    n = len(coordinates)
    return Robots(tuple(range(1, n + 1)), ("single_integrator",) * n, coordinates, 0.0 * coordinates, constants)


def trolleys(n: int = 12) -> Robots:
    rng = np.random.default_rng(n)
    mass = rng.uniform(60.0, 140.0, n)
    p = 0.29 * (-1.0) ** np.arange(n) * rng.uniform(0.7, 1.3, n)
    return robots(p[:, None], mass=1200.0 * mass / mass.sum())


def ring(n: int = 12) -> Robots:
    """Second moments 0.15 I about a centre at (0.02, -0.015) m, 4.8 kg."""
    rng = np.random.default_rng(n)
    mass = rng.uniform(0.2, 0.6, n)
    mass *= 4.8 / mass.sum()
    q = np.stack([np.cos(2.0 * np.pi * np.arange(n) / n), np.sin(2.0 * np.pi * np.arange(n) / n)], axis=1)
    q -= mass @ q / 4.8
    values, vectors = np.linalg.eigh((mass[:, None] * q).T @ q)
    return robots(q @ vectors @ np.diag(np.sqrt(0.15 / values)) @ vectors.T + [0.02, -0.015], mass=mass)


def rotors(n: int = 16, mass: float = 12.0) -> Robots:
    """Half of them at 0.9 m and half at 0.55 m, their spins alternating; 208 N together; rotor 3 has a lag of 51 ms."""
    i, rng = np.arange(1, n + 1), np.random.default_rng(n)
    angle, distance = 4.0 * np.pi * i / n + np.where(i > n // 2, 2.0 * np.pi / n, 0.0), np.where(i > n // 2, 0.55, 0.9)
    lag, highest = rng.uniform(0.03, 0.07, n), rng.uniform(11.0, 15.0, n)
    lag[2] = 0.051
    return robots(
        np.full((n, 1), mass * GRAVITY / n), x=distance * np.cos(angle), y=distance * np.sin(angle), spin=(-1.0) ** i,
        time_constant=lag, highest=208.0 * highest / highest.sum(),
    )  # fmt: skip


SYSTEMS: list[tuple[System, Robots]] = [(Ship(), trolleys()), (Plate(), ring()), (Payload(), rotors())]


def slope(time: Array, values: Array) -> Array:
    """Return the derivative of smooth samples."""
    return np.asarray(make_interp_spline(time, values, k=5).derivative()(time))


@pytest.mark.parametrize(("system", "swarm"), SYSTEMS)
def test_jacobian_and_curvature_are_derivatives_of_the_contribution(system: System, swarm: Robots) -> None:
    q, c, step = swarm.coordinates, swarm.constants, 1e-3
    v = np.random.default_rng(0).normal(size=q.shape)
    ahead, here, behind = (system.contribution(q + x * v, c) for x in (step, 0.0, -step))
    assert_allclose(np.einsum("ikd,id->ik", system.jacobian(q, c), v), (ahead - behind) / (2 * step), atol=1e-8)
    if not isinstance(system, Payload):
        assert_allclose(system.curvature(v, c), (ahead - 2 * here + behind) / step**2, atol=1e-6)


def forward(rates: Sequence[complex], error: Array, error_rate: Array, time: Array) -> Array:
    """Return the solution of e'' + (r1 + r2) e' + r1 r2 e = 0."""
    first, second = rates
    other = (error_rate + first * error) / (first - second)
    return np.outer(np.exp(-first * time), error - other) + np.outer(np.exp(-second * time), other)


@pytest.mark.parametrize(("system", "swarm"), SYSTEMS)
def test_error_of_velocity_robots_decays_by_its_gain_whatever_the_parent_does(system: System, swarm: Robots) -> None:
    k = np.linspace(4.0, 9.0, system.completion[0].size)
    q = swarm.coordinates * np.linspace(0.9, 1.1, len(swarm.coordinates))[:, None]
    s = Loop(system, replace(swarm, coordinates=q), Gains(k)).solve(1.5)
    e = s.wanted - s.abstract
    assert np.abs(e[0]).max() > 1e-3
    assert_allclose(e, np.exp(-np.outer(s.time, k)) * e[0], atol=1e-6 * np.abs(s.wanted).max())


@pytest.mark.parametrize(("system", "swarm"), SYSTEMS[:2])
@pytest.mark.parametrize("kinds", [(FORCE,), (FORCE, "single_integrator")])
@pytest.mark.system
def test_error_of_force_robots_obeys_its_linear_equation(system: System, swarm: Robots, kinds: tuple[str, ...]) -> None:
    """In a mixed swarm the second-order law alone decides nothing, but the error vanishes."""
    s = Loop(system, swarm.with_kinds(*kinds), Gains(5.0, 18.0, 9.0)).solve(2.5)
    e = s.wanted - s.abstract
    if len(kinds) == 1:
        assert_allclose(
            e, forward((3.0, 6.0), e[0], s.wanted_rate[0] - s.rate[0], s.time), atol=1e-6 * np.abs(s.wanted).max()
        )
    else:
        assert np.all(np.abs(e[-1]) < 0.03 * np.abs(e).max(axis=0))


@pytest.mark.parametrize("n", [4, 12])
def test_energy_of_the_ship(n: int) -> None:
    ship = Ship()
    s = Loop(ship, trolleys(n), SHIP).solve(8.0)
    (roll, rate), (torque, inertia), inertia_rate = s.parent.T, s.abstract.T, s.rate[:, 1]
    wave = np.array([ship.wave(t) for t in s.time])
    energy = 0.5 * (ship.inertia + inertia) * rate**2 + 0.5 * ship.stiffness * roll**2
    power = -(np.cos(roll) * torque + wave) * rate - (ship.damping + 0.5 * inertia_rate) * rate**2
    assert energy[0] - energy[-1] > 100.0
    assert simpson(power, x=s.time) == pytest.approx(energy[-1] - energy[0], rel=1e-6)


def test_estimate_of_the_wave_lags_by_the_observer_alone() -> None:
    """Once the error of the swarm is gone, L (tau_w - tau_w^) is the rate of tau_w^."""
    ship = Ship()
    s = Loop(ship, trolleys(), SHIP).solve(8.0)
    estimate = -ship.estimate_bandwidth * ((ship.inertia + s.wanted[:, 1]) * s.parent[:, 1] - s.estimate[:, 0])
    wave = np.array([ship.wave(t) for t in s.time])
    late = (s.time > 4.0) & (np.abs(s.time - 5.0) > 0.1)
    # J_s' r' is in neither the observer nor the momentum's rate: they agree because P has J_sd.
    assert_allclose((slope(s.time, estimate) / ship.estimate_bandwidth + estimate)[late], wave[late], atol=1.0)


def test_momenta_of_the_plate_obey_the_balance_of_angular_momentum_in_space() -> None:
    """About the fixed axis alpha and the moving axis beta, with all bodies' positions in space and no Lagrangian."""
    plate, swarm = Plate(friction=(0.0, 1.0, 1.0, 0.0, 1.0, 1.0)), ring(5)
    s = Loop(plate, swarm, PLATE).solve(2.0)
    alpha, mass, zero = s.parent[:, 0], swarm.constants["mass"], np.zeros(len(s.time))
    rates = slope(s.time, s.parent[:, :2])
    first, second = np.stack([1 + zero, zero, zero], 1), np.stack([zero, np.cos(alpha), np.sin(alpha)], 1)
    turn = Rotation.from_euler("XY", s.parent[:, :2])
    spin = turn.inv().apply(rates[:, :1] * first + rates[:, 1:] * second)
    flat = np.concatenate([s.coordinates, 0 * s.coordinates[:, :, :1]], axis=2)
    moving = np.concatenate([s.velocities, 0 * s.velocities[:, :, :1]], axis=2)
    bodies = np.array(plate.inertias) * spin
    carried = np.einsum("i,tid->td", mass, np.cross(flat, np.cross(spin[:, None], flat) + moving))
    momentum = turn.apply(bodies + carried)
    along = [np.sum(momentum * axis, axis=1) for axis in (first, second)]
    assert_allclose(np.stack(along, 1), s.parent[:, 2:], atol=1e-5)

    centre = turn.apply(np.einsum("i,tid->td", mass, flat))
    weight = np.cross(centre, [0.0, 0.0, -GRAVITY])
    drive = np.array(plate.disturbance) * np.stack([np.sin(0.5 * s.time), np.cos(0.7 * s.time)], 1) - rates
    balance = np.sum(weight * second, axis=1) + np.sum(momentum * slope(s.time, second), axis=1) + drive[:, 1]
    # Splines are poor at their ends.
    for momenta, torque in zip(along, (weight[:, 0] + drive[:, 0], balance), strict=True):
        assert_allclose(slope(s.time, momenta)[5:-5], torque[5:-5], atol=1e-5)


@pytest.mark.system
def test_payload_turns_as_its_body_rates_say_and_keeps_its_energy_balance() -> None:
    payload = Payload()
    s = Loop(payload, rotors(), PAYLOAD).solve(6.0)
    v, w = s.parent[:, 3:6], s.parent[:, 9:]
    turn = Rotation.from_euler("ZYX", s.parent[:, [8, 7, 6]]).as_matrix()
    skew = np.einsum("tji,tjk->tik", turn, slope(s.time, turn))
    assert_allclose(np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1), w, atol=1e-5)
    gust = np.array(payload.wind) * np.sin(np.stack([0.7 * s.time, 0.5 * s.time + 1.0, 0.9 * s.time], axis=1))
    force = s.abstract[:, :1] * turn[:, :, 2] + gust - payload.drag * v - [0.0, 0.0, payload.mass * GRAVITY]
    power = np.sum(force * v, axis=1) + np.sum((s.abstract[:, 1:] - payload.angular_drag * w) * w, axis=1)
    energy = 0.5 * payload.mass * np.sum(v * v, axis=1) + 0.5 * np.sum(np.array(payload.inertias) * w * w, axis=1)
    assert energy.max() > 1.0
    assert_allclose(slope(s.time, energy), power, atol=1e-4)


def test_limited_rates_are_the_least_that_give_the_rate_wanted() -> None:
    payload, swarm, rng = Payload(limits="leave"), rotors(), np.random.default_rng(0)
    c, on = swarm.constants, np.arange(16) != 2
    jacobian = payload.jacobian(swarm.coordinates, c)
    flat, pull, limited = jacobian[:, :, 0], jacobian.transpose(0, 2, 1), 0
    for _ in range(100):
        q = rng.uniform(6.0, 11.0, (16, 1))
        drift, demand = -2.0 * q, rng.normal(0.0, 1.0, 4) * [100.0, 40.0, 40.0, 0.3]
        dual = np.linalg.solve(flat[on].T @ flat[on], demand - flat[on].T @ drift[on, 0])
        free = drift + pull @ dual
        u = payload.limited(free, Law(on, q, jacobian, pull, drift, c, demand, dual))[on, 0]
        low, high = -q[:, 0] / c["time_constant"], (c["highest"] - q[:, 0]) / c["time_constant"]
        rows = np.concatenate([1e4 * flat[on].T, np.eye(15)])
        oracle = lsq_linear(rows, np.concatenate([1e4 * demand, drift[on, 0]]), (low[on], high[on]), tol=1e-13).x
        assert_allclose(u, oracle, atol=1e-3 * np.abs(oracle).max())
        limited += bool(np.any(np.abs(u - free[on, 0]) > 1e-6))
    assert limited > 20


def test_failed_rotor_fades_and_is_counted_on_until_it_is_known() -> None:
    payload, swarm = Payload(), rotors()
    s = Loop(payload, swarm, PAYLOAD, events=[Event(1.0, 3, "fails", 0.1)]).solve(1.5)
    f, after = s.coordinates[:, 2, 0], s.time >= 1.0
    assert_allclose(f[after], f[100] * np.exp(-(s.time[after] - 1.0) / 0.051), rtol=1e-6)
    flat = payload.jacobian(swarm.coordinates, swarm.constants)[:, :, 0]
    assert_allclose(s.abstract, np.einsum("ik,ti->tk", flat, s.coordinates[:, :, 0]), atol=1e-9)
    rest = np.einsum("ik,ti->tk", np.delete(flat, 2, 0), np.delete(s.coordinates[:, :, 0], 2, 1))
    known = s.wanted[111:] - rest[111:]
    assert_allclose(known, np.exp(-20.0 * (s.time[111:, None] - 1.11)) * known[0], atol=1e-5)


@pytest.mark.parametrize("what", ["joins", "leaves", "stands"])
def test_plate_turns_on_when_a_robot_joins_leaves_or_stands(what: str) -> None:
    loop = Loop(Plate(), ring(), PLATE, events=[Event(0.5, 4, what)])
    s = loop.solve(1.0)
    still = s.coordinates[:51, 3] if what == "joins" else s.coordinates[51:, 3]
    assert_allclose(still, np.broadcast_to(still[0], still.shape))
    rates = np.diff(s.parent[:, :2], axis=0) / 0.01
    assert np.abs(np.diff(rates[45:55], axis=0)).max() < 0.02  # no jump, 10 ms apart
    # The robot's part of the inertia is gone, or there, at once.
    assert (np.abs(np.diff(s.abstract[49:53, 2:], axis=0)).max() > 0.01) == (what != "stands")
    e = (s.wanted - s.abstract)[51:]
    assert_allclose(e, np.exp(-8.0 * (s.time[51:, None] - 0.51)) * e[0], atol=1e-6)


def second_half(values: Array) -> tuple[Any, Any]:
    late = values[len(values) // 2 :]
    return np.sqrt(np.mean(late**2, axis=0)), np.abs(late).max(axis=0)


def plate_error(s: Solution) -> Array:
    return s.parent[:, :2] - np.array([Plate().wanted(t)[0] for t in s.time])


@pytest.mark.full
@pytest.mark.parametrize(
    ("ship", "duration", "rms", "largest"),
    [
        (Ship(rate_gain=0.0, with_estimate=False), 120.0, 0.141, 0.305),
        (Ship(with_estimate=False), 120.0, 0.046, 0.110),
        (Ship(), 60.0, 0.0057, 0.014),
    ],
)
def test_published_figures_of_the_ship(ship: Ship, duration: float, rms: float, largest: float) -> None:
    for swarm in (trolleys(), trolleys(4).with_kinds(FORCE)):
        got = second_half(Loop(ship, swarm, SHIP).solve(duration).parent[:, 0])
        assert got == pytest.approx((rms, largest), rel=0.012)


@pytest.mark.full
@pytest.mark.parametrize(
    ("n", "kinds"),
    [(3, ["single_integrator"]), (12, [FORCE]), (12, [FORCE, "single_integrator"]), (40, ["single_integrator"])],
)
def test_published_figures_of_the_plate(n: int, kinds: list[str]) -> None:
    rms, largest = second_half(plate_error(Loop(Plate(), ring(n).with_kinds(*kinds), PLATE).solve(30.0)))
    assert_allclose(rms, [0.0025, 0.0023], atol=1e-4)
    assert_allclose(largest, [0.0033, 0.0033], atol=1e-4)


@pytest.mark.full
@pytest.mark.parametrize(
    ("k", "known", "rms", "height", "tilt", "thrust"),
    [
        (4, None, (0.150, 0.099, 0.013), 0.018, 0.034, 8.06),
        (4, 0.1, (0.137, 0.101, 0.013), 0.019, 0.056, 10.6),
        (3, 0.1, (0.137, 0.101, 0.013), 0.019, 0.056, 10.0),
        (4, 99.0, (1.373, 1.328, 0.152), 0.178, 0.147, 10.3),
    ],
)
def test_published_figures_of_the_payload(
    k: int, known: float | None, rms: tuple[float, ...], height: float, tilt: float, thrust: float
) -> None:
    """Rotor 3 fails at 10 s, and the others know it some time later."""
    payload, events = Payload(yaw=k == 4), [] if known is None else [Event(10.0, 3, "fails", known)]
    s = Loop(payload, rotors(), PAYLOAD, events=events).solve(20.0)
    got, largest = second_half(s.parent[:, :3] - np.array([payload.wanted(t)[0] for t in s.time]))
    assert_allclose(got, rms, atol=1e-3)
    assert largest[2] == pytest.approx(height, abs=6e-4)
    assert np.abs(s.parent[1000:, 6:8]).max() == pytest.approx(tilt, abs=6e-4)
    assert s.coordinates.max() == pytest.approx(thrust, abs=0.06)
    if known == 0.1:
        assert np.abs(s.parent[1045:, 6:8]).max() < 0.05


@pytest.mark.full
def test_overloaded_payload_recovers_when_limited_rotors_leave_their_part_to_the_others() -> None:
    """17 kg in half the wind; published: 0.046 m, 0.052 m, 0.056 rad; 0.088 rad if thrusts are clipped."""
    swarm, failure, tilts = rotors(mass=17.0), [Event(10.0, 3, "fails", 0.1)], {}
    for limits in ("leave", "clip"):
        payload = Payload(mass=17.0, wind=(1.5, 1.0, 0.5), limits=limits)
        s = Loop(payload, swarm, PAYLOAD, events=failure).solve(20.0, rtol=1e-6, atol=1e-7)
        command = s.coordinates + swarm.constants["time_constant"][:, None] * s.velocities
        top = swarm.constants["highest"][:, None]
        assert command.min() >= -1e-6 and np.all(command <= top + 1e-6) and np.any(command > top - 1e-6)
        got, _ = second_half(s.parent[:, :3] - np.array([payload.wanted(t)[0] for t in s.time]))
        tilts[limits] = np.abs(s.parent[1000:, 6:8]).max()
        if limits == "leave":
            assert_allclose(got[:2], (0.046, 0.052), atol=2e-3)
            assert tilts[limits] == pytest.approx(0.056, abs=1e-3)
            assert np.abs(s.parent[1040:, 6:8]).max() < 0.05
    assert tilts["clip"] > tilts["leave"]
