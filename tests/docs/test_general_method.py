"""docs/explanation/general_method*.md and losses.md: formulas and numbers, by NumPy and SciPy, not by the package."""

from collections.abc import Callable
from itertools import product
from math import pi

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from tests.docs.pages import read

Array = NDArray[np.float64]
PAGES = ("general_method", "general_method_ship", "losses")
PAGE = " ".join("".join(read(f"docs/explanation/{name}.md") for name in PAGES).split())
GRAVITY = 9.81
SEEDS = pytest.mark.parametrize("seed", range(5))
TINY = 1e-30
"""Imaginary step that differentiates analytic functions without rounding."""


def prints(*phrases: str) -> bool:
    """Tell whether the pages have all phrases, wherever its lines break."""
    return all(phrase in PAGE for phrase in phrases)


def moments(m: Array, q: Array) -> Array:
    """First and second moments, in any number of dimensions."""
    pairs = [(i, j) for i in range(q.shape[1]) for j in range(i, q.shape[1])]
    return np.array([*(GRAVITY * m @ q), *(m @ (q[:, i] * q[:, j]) for i, j in pairs)])


def bent(m: Array, q: Array) -> Array:
    """Some abstract state that is no polynomial."""
    x, y = q.T
    return np.array([m @ np.sin(x + 0.3 * y), m @ (x * np.exp(0.5 * y)), m**2 @ (y**3 + x * y)])


def bent_jacobians(m: Array, q: Array) -> Array:
    """J_i of `bent`: robots, rows of a, coordinates."""
    x, y = q.T
    first, second = m * np.cos(x + 0.3 * y), m * np.exp(0.5 * y)
    rows = [(first, 0.3 * first), (second, 0.5 * x * second), (m**2 * y, m**2 * (3.0 * y**2 + x))]
    return np.stack([np.stack(row, 1) for row in rows], 1)


def jacobians(phi: Callable[[Array, Array], Array], m: Array, q: Array) -> Array:
    """J_i of any abstract state by complex steps."""
    found = np.zeros((*q.shape, len(phi(m, q))))
    for place in np.ndindex(q.shape):
        moved = q.astype(complex)
        moved[place] += TINY * 1j
        found[place] = np.imag(phi(m, moved)) / TINY
    return found.transpose(0, 2, 1)


def gram(j: Array, w: Array) -> Array:
    return np.asarray(np.einsum("iab,icb,i->ac", j, j, 1.0 / w))


def through(j: Array, velocity: Array) -> Array:
    """Sum of J_i q_i'."""
    return np.asarray(np.einsum("iab,ib->a", j, velocity))


def move(j: Array, w: Array, right: Array, s: Array | None = None) -> Array:
    """W^-1 J^T S^-1 right of each robot; S by default of these robots alone."""
    y = np.linalg.solve(gram(j, w) if s is None else s, right)
    return np.asarray(np.einsum("iab,a->ib", j, y) / w[:, None])


def curvature(m: Array, q: Array, dq: Array) -> Array:
    """h of `bent`."""
    return np.imag(through(bent_jacobians(m, q + TINY * 1j * dq), dq)) / TINY


def bent_swarm(seed: int) -> tuple[np.random.Generator, Array, Array, Array, Array]:
    """Return a generator and masses, weights, coordinates and Jacobians of seven robots."""
    rng = np.random.default_rng(seed)
    m, w, q = rng.uniform(0.2, 0.7, 7), rng.uniform(0.5, 2.0, 7), rng.uniform(-1.0, 1.0, (7, 2))
    j = bent_jacobians(m, q)
    np.testing.assert_allclose(j, jacobians(bent, m, q), atol=1e-14)
    return rng, m, w, q, j


@SEEDS
def test_velocity_law_is_exact_and_of_least_effort(seed: int) -> None:
    """Propositions 1 and 3 and the bound on the effort; robots 0 and 1 do not follow the law but move."""
    rng, m, w, q, j = bent_swarm(seed)
    xi, v = rng.normal(size=(7, 2)), rng.normal(size=3)
    r = through(j, xi)
    u = xi.copy()
    u[2:] += move(j[2:], w[2:], v - r)
    np.testing.assert_allclose(np.imag(bent(m, q + TINY * 1j * u)) / TINY, v, atol=1e-12)

    root = np.sqrt(w[2:])[:, None]
    least = np.linalg.pinv(np.hstack(list(j[2:] / root[..., None]))) @ (v - r)
    np.testing.assert_allclose((u - xi)[2:] * root, least.reshape(5, 2), atol=1e-9)
    effort = (v - r) @ np.linalg.solve(gram(j[2:], w[2:]), v - r)
    assert least @ least == pytest.approx(effort, rel=1e-9)
    half = 0.5 * (u - xi)  # what robots do if E_max = E/2
    np.testing.assert_allclose(through(j, xi + half) - r, 0.5 * (v - r), atol=1e-12)
    assert (w[2:] * (half[2:] ** 2).sum(1)).max() <= 0.25 * effort


@SEEDS
def test_force_law_is_exact_and_damps_what_is_not_seen(seed: int) -> None:
    """Proposition 2, and the velocity law's remainder."""
    rng, m, w, q, j = bent_swarm(seed)
    dq, wanted, sigma = rng.normal(size=(7, 2)), rng.normal(size=3), 1.3

    def follow(dq: Array) -> Array:
        h = curvature(m, q, dq)
        return np.asarray(-sigma * dq + move(j, w, wanted + sigma * through(j, dq) - h))

    step = TINY * 1j
    ahead = through(bent_jacobians(m, q + step * dq), dq + step * follow(dq))
    np.testing.assert_allclose(np.imag(ahead) / TINY, wanted, atol=1e-10)
    unseen = dq - move(j, w, through(j, dq))
    assert np.abs(through(j, unseen)).max() < 1e-12
    power = w @ (unseen * follow(unseen)).sum(1)
    assert power == pytest.approx(-sigma * w @ (unseen**2).sum(1), rel=1e-9)


@SEEDS
def test_moments_weighted_by_mass(seed: int) -> None:
    """Proposition 4: no auxiliary sums, one matrix for all robots, bounds of distances."""
    rng = np.random.default_rng(seed)
    m, q = rng.uniform(0.2, 0.7, 6), rng.uniform(-1.0, 1.0, (6, 2))

    def spread(m: Array, q: Array) -> Array:
        off = q - m @ q / m.sum()
        return np.asarray(np.einsum("i,ia,ib->ab", m, off, off))

    others, place = rng.uniform(0.2, 0.7, 9), rng.uniform(-1.0, 1.0, (9, 2))  # another swarm of equal moments
    others *= m.sum() / others.sum()
    change = np.linalg.cholesky(spread(m, q)) @ np.linalg.inv(np.linalg.cholesky(spread(others, place)))
    place = (place - others @ place / m.sum()) @ change.T + m @ q / m.sum()
    np.testing.assert_allclose(moments(others, place), moments(m, q), atol=1e-12)
    right = gram(jacobians(moments, m, q), m)
    np.testing.assert_allclose(gram(jacobians(moments, others, place), others), right, atol=1e-10)
    lane = q[:, :1]
    tau, inertia = moments(m, lane)
    expected = [[GRAVITY**2 * m.sum(), 2.0 * tau], [2.0 * tau, 4.0 * inertia]]
    np.testing.assert_allclose(gram(jacobians(moments, m, lane), m), expected, rtol=1e-12)

    line = np.outer(q[:, 0], [0.6, -0.8]) + 0.3
    assert np.linalg.cond(gram(jacobians(moments, m, line), m)) > 1e12
    assert np.linalg.matrix_rank(gram(jacobians(moments, m[:3], q[:3]), m[:3])) == 5

    for start in (lane, q):
        goal = moments(m, start * rng.uniform(0.5, 0.8) + 0.2)
        goal[-1] *= 1.3

        def law(_: float, x: Array, goal: Array = goal, size: int = start.shape[1]) -> Array:
            at = x.reshape(-1, size)
            return move(jacobians(moments, m, at), m, 2.0 * (goal - moments(m, at))).ravel()

        end = solve_ivp(law, (0.0, 1.0), start.ravel(), rtol=1e-10, atol=1e-12).y[:, -1].reshape(start.shape)
        before, after = start - m @ start / m.sum(), end - m @ end / m.sum()
        common = np.linalg.lstsq(before, after, rcond=None)[0]
        np.testing.assert_allclose(before @ common, after, atol=1e-7)
        g0, g1 = np.linalg.eigvalsh(spread(m, start)), np.linalg.eigvalsh(spread(m, end))
        if len(g0) == 1:
            np.testing.assert_allclose(after, np.sqrt(g1[0] / g0[0]) * before, atol=1e-7)
        ratio = [
            np.linalg.norm(after[a] - after[b]) / np.linalg.norm(before[a] - before[b])
            for a in range(6)
            for b in range(a)
        ]
        assert min(ratio) >= np.sqrt(g1[0] / g0[-1]) - 1e-7
        assert (np.linalg.norm(after, axis=1) / np.linalg.norm(before, axis=1)).max() <= np.sqrt(g1[-1] / g0[0]) + 1e-7


@SEEDS
def test_every_composition_is_stable(seed: int) -> None:
    """Proposition 5: the matrix of (e, a_F') from both laws, against trace and determinant."""
    rng, _, w, _, j = bent_swarm(seed)
    k, kp, kd, sigma = 10.0 ** rng.uniform(-1.0, 1.5, 4)
    for count in range(8):
        p = gram(j[:count], w[:count]) @ np.linalg.inv(gram(j, w))
        one, rest = np.eye(3), np.eye(3) - p
        # a_d rests: e' = -a' = -(P K e + a_F'), a_F'' = -sigma a_F' + (1 - P)(Kp e + Kd e' + sigma a')
        both = np.block(
            [[-k * p, -one], [rest @ (kp * one + (kd - sigma) * k * -p), -sigma * one - (kd - sigma) * rest]]
        )
        expected = []
        for share in np.linalg.eigvals(p):
            assert abs(share.imag) < 1e-6
            assert -1e-6 < share.real < 1.0 + 1e-6
            trace = -(share * k + (1.0 - share) * kd + share * sigma)
            expected += list(np.roots([1.0, -trace, share * k * sigma + (1.0 - share) * kp]))
        assert max(np.real(expected)) < 0.0
        np.testing.assert_allclose(np.poly(both), np.real(np.poly(expected)), rtol=1e-5)


@pytest.mark.parametrize("swing", [0.0, 0.1])
@pytest.mark.parametrize("seed", [1, 3])
def test_mixed_swarm_converges_while_it_moves(seed: int, swing: float) -> None:
    """What the page calls checked: P changes, and a moving reference leaves a small residual."""
    rng, m, w, q, _ = bent_swarm(seed)
    first = rng.normal(size=(4, 2)) * 0.1  # robots 3 to 6 are driven by forces
    base = bent(m, q) * 1.1

    def wanted(t: float) -> tuple[Array, Array, Array]:
        return base + swing * np.sin(t), np.full(3, swing * np.cos(t)), np.full(3, -swing * np.sin(t))

    def error(t: float, x: Array) -> Array:
        return np.asarray(wanted(t)[0] - bent(m, x[:14].reshape(7, 2)))

    def rates(t: float, x: Array) -> Array:
        at, slow = x[:14].reshape(7, 2), x[14:].reshape(4, 2)
        j = bent_jacobians(m, at)
        s, e = gram(j, w), error(t, x)
        _, da, dda = wanted(t)
        dq = np.vstack([move(j[:3], w[:3], 5.0 * e + da, s), slow])
        rate = through(j, dq)
        right = 16.0 * e + 8.0 * (da - rate) + dda + rate - curvature(m, at, dq)
        return np.concatenate([dq.ravel(), (-slow + move(j[3:], w[3:], right, s)).ravel()])

    ran = solve_ivp(rates, (0.0, 12.0), np.concatenate([q.ravel(), first.ravel()]), rtol=1e-8, atol=1e-10)
    found = np.abs([error(s, x) for s, x in zip(ran.t, ran.y.T, strict=True)]).max(1)
    assert found[ran.t > 8.0].max() < (0.03 if swing else 1e-3) * found.max()


def radius(coefficients: list[float]) -> float:
    return float(np.abs(np.roots(coefficients)).max())


def test_limits_of_sampled_laws() -> None:
    """Section Sampled time, with the products of gain and period at the limits."""
    for delay in range(4):
        limit = 2.0 * np.sin(pi / (2.0 * (2 * delay + 1)))
        below, above = (
            radius([1.0, -1.0, *[0.0] * (delay - 1), x]) if delay else abs(1.0 - x)
            for x in (0.999 * limit, 1.001 * limit)
        )
        assert below < 1.0 < above
        below, above = (radius([1.0, 0.5 * x - 1.0, 0.5 * x]) for x in (1.998, 2.002))  # of the velocity law
        assert below < 1.0 < above
    for kp, kd in [(10.0, 5.0), (50.0, 5.0), (1.0, 5.0)]:
        limit = min(2.0 / kd, 2.0 * kd / kp)
        for dt, stable in ((0.999 * limit, True), (1.001 * limit, False)):
            step = np.array([[1.0 - 0.5 * dt**2 * kp, dt - 0.5 * dt**2 * kd], [-dt * kp, 1.0 - dt * kd]])
            assert (np.abs(np.linalg.eigvals(step)).max() < 1.0) == stable

    rng = np.random.default_rng(0)
    m, q, dt = rng.uniform(0.2, 0.7, 5), rng.uniform(-1.0, 1.0, (5, 2)), 0.05
    a_d, after, k = moments(m, q) + 0.1, moments(m, q) + 0.17, 4.0
    u = move(jacobians(moments, m, q), m, k * (a_d - moments(m, q)) + (after - a_d) / dt)
    bend = moments(m, u)
    bend[:2] = 0.0  # u^T H u/2 of first and second moments
    np.testing.assert_allclose(
        after - moments(m, q + dt * u), (1.0 - k * dt) * (a_d - moments(m, q)) - dt**2 * bend, atol=1e-14
    )


def test_completion_keeps_the_swarm_reachable() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        mass, least, standing = rng.uniform(2.0, 4.0), rng.uniform(0.5, 2.0), rng.uniform(0.1, 1.0)
        need, x_s = rng.normal(size=2) * 3.0, rng.normal(size=2)
        offset = 0.1 * np.eye(2)
        wide = np.outer(need, need) / (GRAVITY**2 * least) + offset
        assert np.linalg.eigvalsh(wide - np.outer(need, need) / (GRAVITY**2 * mass) - offset)[0] > -1e-12
        i_s = np.outer(x_s, x_s) / standing  # of one robot
        x_a = need / GRAVITY - x_s
        moving, form = mass - standing, np.outer(need, need)
        wider = 1.0 / (GRAVITY**2 * least) - 1.0 / (GRAVITY**2 * mass)
        around = i_s + np.outer(x_a, x_a) / moving + wider * form + (moving / mass) ** 2 * offset
        left = around - i_s - np.outer(x_a, x_a) / moving
        assert np.linalg.eigvalsh(left)[0] > 0.0
        usual = form / (GRAVITY**2 * mass) + wider * form + offset
        np.testing.assert_allclose(usual, wide, atol=1e-12, err_msg="the usual completion if nothing stands")

    m, total, offset = 0.6762, 0.3552 + 0.3532 + 0.6762 + 0.4596, 0.025  # robot 3 of the paper, the manifold at 0

    def left_over(p: float) -> float:
        return offset - m * p**2 - (m * p) ** 2 / (total - m)

    edge = brentq(left_over, 0.0, 1.0)
    assert edge == pytest.approx(np.sqrt(offset / (m * (1.0 + m / (total - m)))))
    assert prints(f"{edge:.3f} m for robot 3")


def test_margin_of_the_first_theorem() -> None:
    """The best kappa is c2/c3, and what it requires, by a scan."""
    rng = np.random.default_rng(0)
    outcomes = set()
    for c1, c2, c3, c4, least in rng.uniform(0.1, 2.0, (300, 5)):
        kappa = np.append(np.logspace(-4, 4, 801), c2 / c3)
        margin = 4.0 * c1 * kappa * (least - c4) - (c2 + kappa * c3) ** 2
        assert (margin.max() > 0.0) == (c2 * c3 < c1 * (least - c4))
        outcomes.add(bool(margin.max() > 0.0))
    assert outcomes == {True, False}


J, C, K0, K2, RATE = 4e4, 5.4e3, 5e4, 4e4, 10.0
A, B, LIMIT, MASS, OMEGA, EPS = 1e-5, 100.0, 8000.0, 1200.0, 50.0, 0.2
WAVES = ((1500.0, 0.11, 0.0), (2500.0, 0.15, 1.0), (1200.0, 0.19, 2.0))


def waves(t: float) -> float:
    s = min(1.0, t / 5.0)
    return s * s * (3.0 - 2.0 * s) * sum(a * np.sin(2.0 * pi * f * t + phase) for a, f, phase in WAVES)


def ship(t: float, x: Array, torque: float, torque_rate: float, e: Array, sea: Callable[[float], float]) -> Array:
    """Rates of roll, its rate and the estimator's z under a desired torque, and an error e' = -5 e of the swarm."""
    th, w, z = x
    wanted, wanted_rate = A * torque**2 + B, 2.0 * A * torque * torque_rate
    inertia, inertia_rate = J + wanted - e[1], wanted_rate + 5.0 * e[1]
    dw = (-(inertia_rate + C) * w - K0 * th - np.cos(th) * (torque - e[0]) - sea(t)) / inertia
    dz = -C * w - K0 * th - np.cos(th) * torque + RATE * ((J + wanted) * w - z)
    return np.array([w, dw, dz])


@SEEDS
def test_energy_and_cascade_of_the_ship(seed: int) -> None:
    """V_0', V_p' and eta' as on the page, at a random state, from the equations of motion."""
    rng = np.random.default_rng(seed)
    th, w, slope, t = rng.uniform(-0.3, 0.3), rng.normal() * 0.1, rng.normal() * 3e4, 7.0
    e, eta = rng.normal(size=2) * (300.0, 5.0), rng.normal() * 300.0
    torque = (K2 * w - waves(t) + eta) / np.cos(th)
    z = (J + A * torque**2 + B) * w + (waves(t) - eta) / RATE
    rate = ship(t, np.array([th, w, z]), torque, slope, e, waves)

    def along(h: float) -> tuple[float, float, float]:
        """V_0, V_p, eta - tau_w a step later."""
        th1, w1, z1 = np.array([th, w, z]) + h * rate
        torque1, e1 = torque + h * slope, e * (1.0 - 5.0 * h)
        wanted = A * torque1**2 + B
        inertia = J + wanted - e1[1]
        energy = 0.5 * (inertia * w1**2 + K0 * th1**2)
        return energy, energy + EPS * inertia * th1 * w1, RATE * ((J + wanted) * w1 - z1)

    found = (np.array(along(1e-6)) - along(-1e-6)) / 2e-6
    inertia = J + A * torque**2 + B - e[1]
    change = 2.0 * A * torque * slope + 5.0 * e[1]
    push = np.cos(th) * e[0] - eta
    first = -(C + K2 + 0.5 * change) * w**2 + w * push
    form = np.array([[EPS * K0, EPS * (C + K2) / 2], [EPS * (C + K2) / 2, C + K2 + 0.5 * change - EPS * inertia]])
    second = -np.array([th, w]) @ form @ [th, w] + (w + EPS * th) * push
    mixed = -5.0 * e[1] * w + e[1] * rate[1]  # (e_J w)'
    third = RATE * (-eta + np.cos(th) * e[0] + mixed)
    np.testing.assert_allclose(found, [first, second, third], rtol=1e-5, atol=1e-2)


def test_numbers_of_the_ship() -> None:
    fastest = (
        OMEGA**2
        * LIMIT
        * quad(lambda t: abs((1.0 - OMEGA * t) * np.exp(-OMEGA * t)), 0.0, 1.0, points=[1.0 / OMEGA])[0]
    )
    assert fastest == pytest.approx(2.0 * OMEGA * LIMIT * np.exp(-1.0), rel=1e-8)
    bound = A * LIMIT * fastest
    most = J + B + A * LIMIT**2
    form = np.array([[EPS * K0, EPS * (C + K2) / 2], [EPS * (C + K2) / 2, C + K2 - bound - EPS * most]])
    c1 = np.linalg.eigvalsh(form)[0]
    kappa = (1.0 + EPS**2) / (4.0 * 5.0 * c1)
    assert prints(f"is {C + K2:.0f}", f"to {bound:.0f};", f"$c_1 = {c1:.0f}$", rf"{kappa * 1e6:.1f} \cdot 10^{{-6}}$")

    th = np.linspace(-0.8, 0.8, 20001)
    w = LIMIT * np.cos(th) / K2
    levels = [(0.5 * (i * w**2 + K0 * th**2) + EPS * i * th * w).min() for i in (J + B, most)]
    level, start = int(min(levels)), 0.5 * K0 * 0.15**2
    assert level < 0.5 * K0 * 0.8**2 * (1.0 - EPS**2 * most / K0)
    assert prints(f"$V_p \\le {level}$", f"$V_p = {start:.0f}$") and start < level

    angle, speed = np.meshgrid(np.linspace(-0.25, 0.25, 501), np.linspace(-0.25, 0.25, 501))
    torque = K2 * speed / np.cos(angle)
    inertia = J + B + A * torque**2
    inside = 0.5 * (inertia * speed**2 + K0 * angle**2) + EPS * inertia * angle * speed <= level
    # without filter tau' = k2 w'/cos + tau w tan, and I w' = -(J_d' + c + k2) w - k0 theta with J_d' = 2 A tau tau'
    rest = 2.0 * A * torque**2 * np.tan(angle) * speed
    faster = 2.0 * A * torque * K2 / np.cos(angle)
    dw = (-(C + K2 + rest) * speed - K0 * angle) / (inertia + faster * speed)
    assert prints(f"at most {np.abs(faster * dw + rest)[inside].max() / 2:.0f} in the region")
    poles = np.linalg.eigvals(
        [
            [0, 1, 0, 0],
            [-K0 / (J + B), -C / (J + B), -1 / (J + B), 0],
            [0, 0, 0, 1],
            [0, OMEGA**2 * K2, -(OMEGA**2), -2 * OMEGA],
        ]
    )
    slow = poles[np.argmax(poles.real)]
    assert prints(f"{slow.real:.2f} ± {abs(slow.imag):.2f}i")


def test_constraints_of_the_ship() -> None:
    def outermost(torque: Array, inertia: Array, lightest: float) -> Array:
        """Largest position in the preimage (equations, 7), checked below."""
        first = torque / GRAVITY
        return np.asarray(np.abs(first) / MASS + np.sqrt((inertia - first**2 / MASS) * (1.0 / lightest - 1.0 / MASS)))

    rng = np.random.default_rng(0)
    m = np.array([60.0, 140.0, 100.0, 100.0])
    q = rng.normal(size=(20000, 4))
    q -= (q @ m / m.sum())[:, None]
    q *= np.sqrt(50.0 / (q**2 @ m))[:, None]
    assert np.abs(q).max() == pytest.approx(np.sqrt(50.0 * (1.0 / 60.0 - 1.0 / m.sum())), rel=0.01)

    torque = np.linspace(-LIMIT, LIMIT, 2001)
    inside = outermost(torque, A * torque**2 + B, 60.0).max()
    tube = max(
        outermost(torque - s * e, A * torque**2 + B - x * f, 60.0).max()
        for s, x, e, f in product(np.linspace(0.0, 1.0, 6), (0.0, 1.0), (100.0, -100.0), (10.0, -10.0))
    )
    assert prints(f"{inside:.3f} on $A_d$; {tube:.3f} on") and tube < 2.5
    ends = [brentq(lambda x, m=least: float(outermost(x, A * x**2 + B, m)) - 2.5, 0.0, 2e4) for least in (60.0, 18.0)]
    assert prints(f"up to {int(ends[0])} N m", f"only up to {round(ends[1])}.")
    first = LIMIT / GRAVITY
    law = first / MASS + np.sqrt((A * LIMIT**2 + B - first**2 / MASS) / B) * 0.377
    assert prints(f"within {law:.3f} m", f"= {1.0 / (A * GRAVITY**2):.0f}$")

    m, p = np.array([0.3552, 0.3532, 0.6762, 0.4596]), np.array([0.125, -0.125, 0.125, -0.125])  # the paper's robots
    off = p - m @ p / m.sum()

    def plane(torque: float) -> float:
        first = torque / GRAVITY
        now = 0.0125 * torque**2 + 0.025 - first**2 / m.sum()
        return float(first / m.sum() + np.sqrt(now / (m @ off**2)) * np.abs(off).max() - 0.5)

    assert prints(f"up to {brentq(plane, 0.0, 10.0):.3f} N m")


def test_ship_in_waves() -> None:
    """With e = 0, as the law keeps it: 60 s with the filter, without sampling."""

    def rates(t: float, x: Array) -> Array:
        th, w, z, torque, slope = x
        estimate = -RATE * ((J + A * torque**2 + B) * w - z)
        asked = np.clip((K2 * w - estimate) / np.cos(th), -LIMIT, LIMIT)
        moved = ship(t, x[:3], torque, slope, np.zeros(2), waves)
        return np.array([*moved, slope, OMEGA**2 * (asked - torque) - 2.0 * OMEGA * slope])

    t = np.linspace(0.0, 60.0, 6001)
    x = solve_ivp(
        rates, (0.0, 60.0), [0.15, 0.0, 0.0, 0.0, 0.0], t_eval=t, method="LSODA", rtol=1e-7, atol=1e-8, max_step=0.05
    ).y
    bare = solve_ivp(
        lambda t, y: [y[1], (-C * y[1] - K0 * y[0] - waves(t)) / (J + B)],
        (0.0, 60.0),
        [0.15, 0.0],
        t_eval=t,
        rtol=1e-7,
        atol=1e-8,
    ).y
    before, after = (np.sqrt(np.mean(th[t >= 10.0] ** 2)) for th in (bare[0], x[0]))
    assert prints(
        f"roll is {before:.3f} without and {after:.3f} rad", f"at most {np.abs(A * x[3] * x[4]).max():.0f}. For"
    )
    eta = np.array([waves(s) for s in t]) + RATE * ((J + A * x[3] ** 2 + B) * x[1] - x[2])
    settled = sum(2.0 * pi * f * a for a, f, _ in WAVES) / RATE
    assert prints(f"= {settled:.0f}$") and 0.9 * settled < np.abs(eta[t >= 10.0]).max() < settled
    assert np.abs(x[3]).max() < LIMIT
