"""Section Example Case and tab. PhysicalParameters: the plane, its friction, the abstract space."""

from __future__ import annotations

from itertools import product
from math import cos, sin, sqrt

import numpy as np
import pytest
from tests.errata.paper import (
    FRICTION,
    GAINS,
    GRAVITY,
    INERTIA,
    LENGTH,
    MASS,
    TORQUE_MAX,
    friction,
    manifold,
    slope,
)

from swarmabs_core.behaviours import Agent, AgentConfig
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import AbstractState, AgentState, AuxiliaryState, DesiredAbstractState, Kind, PlaneState
from swarmabs_core.plant import Friction, Plane, PlaneDynamics, standing, straight, swarm_load
from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass

PAPER = Friction(*FRICTION)


def plane(period: float, *, substep: float = 1e-5, law: Friction = PAPER) -> PlaneDynamics:
    return PlaneDynamics(Plane(inertia=INERTIA, friction=law, substep=substep), period)


def test_units_of_the_friction() -> None:
    """tab. PhysicalParameters: a formula with right units gives the same torque whatever the unit of time is."""
    minute = 60.0  # so 1 s = 1/60 min; N m = kg m^2/s^2, N = kg m/s^2
    w = 0.003  # rad/s, where all terms count
    truth = friction(w) * minute**2  # kg m^2/min^2

    def torque(amplitude: float, steepness: float, viscous: float) -> float:
        """Friction in minutes, each kind of parameter times what its unit becomes."""
        g1, g2, g3, g4, g5, g6 = FRICTION
        law = Friction(amplitude * g1, steepness * g2, steepness * g3, amplitude * g4, steepness * g5, viscous * g6)
        return law.torque(w * minute)

    # Printed g2, g3, g5 in s^2 and g6 in N s: their factors are 60^-2 and 60.
    assert abs(torque(minute**2, minute**-2, minute) / truth - 1.0) > 0.2
    # Right: N m, s/rad, N m s/rad.
    assert torque(minute**2, 1.0 / minute, minute) == pytest.approx(truth, rel=1e-12)


def test_amplitudes_of_the_friction_are_torques() -> None:
    """tab. PhysicalParameters prints g1 and g4 in N, g6 in N s: wrong as soon as lengths are not in metres."""
    centimetre = 100.0
    w = 0.003
    truth = friction(w) * centimetre**2  # kg cm^2/s^2
    g1, g2, g3, g4, g5, g6 = FRICTION

    printed = Friction(centimetre * g1, g2, g3, centimetre * g4, g5, centimetre * g6)
    assert abs(printed.torque(w) / truth - 1.0) > 0.9
    right = Friction(centimetre**2 * g1, g2, g3, centimetre**2 * g4, g5, centimetre**2 * g6)
    assert right.torque(w) == pytest.approx(truth, rel=1e-12)


def test_g4_may_exceed_g1() -> None:
    """After eq. frictionModel: g4 <= g1 is demanded; the table violates it, and the friction still takes energy."""
    assert not PAPER.g4 <= PAPER.g1

    speeds = np.concatenate([np.logspace(-6, 1, 200), -np.logspace(-6, 1, 200)])
    for g4 in (0.0, 0.5 * PAPER.g1, PAPER.g4, 10.0 * PAPER.g1):
        law = Friction(PAPER.g1, PAPER.g2, PAPER.g3, g4, PAPER.g5, PAPER.g6)
        assert all(w * law.torque(w) > 0.0 for w in speeds)
    assert [PAPER.torque(w) for w in speeds] == pytest.approx([friction(w) for w in speeds], rel=1e-13)
    dt = 1e-7  # and the plane feels it
    for w in (1e-4, 1e-3, 0.01, 1.0):
        _, after = plane(dt).advance(0.0, w, 0.0, swarm_load([], GRAVITY))
        assert INERTIA * (w - after) / dt == pytest.approx(friction(w), rel=1e-5)


def test_friction_is_not_bounded_by_g1() -> None:
    """lem. J_dot_is_bounded: abs(f_f) <= g1 + g6 abs(w)."""
    speeds = np.logspace(-6, 1, 400)
    assert PAPER.torque(0.1) > PAPER.g1 + PAPER.g6 * 0.1 + 0.009
    assert all(PAPER.torque(w) <= PAPER.g1 + PAPER.g4 + PAPER.g6 * w for w in speeds)


def lagrangian(th: float, w: float, m: float, p: float, v: float) -> float:
    """Kinetic minus potential energy of plane and one robot."""
    return 0.5 * INERTIA * w**2 + 0.5 * m * (v**2 + (p * w) ** 2) - m * GRAVITY * p * sin(th)


def test_force_driven_robots_feel_the_plane() -> None:
    """eq. EOM_DI without command and damping says p'' = 0; Lagrange says m p'' = dL/dp."""
    m, p, th, w, dt = 0.4, 0.2, 0.3, 1.5, 1e-6
    truth = slope(lambda x: lagrangian(th, w, m, x, 0.0), p) / m
    assert truth == pytest.approx(-GRAVITY * sin(th) + p * w**2, rel=1e-8)

    def acceleration(*, feels: bool) -> float:
        """Of a robot whose law commands nothing, since the state is the wanted one."""
        config = AgentConfig(
            agent_id=1,
            kind=Kind.DOUBLE_INTEGRATOR,
            mass=m,
            position=p,
            velocity=0.0,
            gains=GAINS,
            period_ns=round(dt * 1e9),
            gravity=GRAVITY,
            plane_length=LENGTH,
            damping=0.0,
            feels_gravity=feels,
        )
        agent = Agent(config)
        agent.start()
        messages = (
            AbstractState(0, 0, 2, 0.1, 0.03, 0.0, 0.0),
            AuxiliaryState(0, 0, 0.3, 0.01, 0.01, 0.002, 0.5, 0.0, 0.01, 0.0),
            DesiredAbstractState(0, 0, 1, 0.1, 0.03, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            PlaneState(0, 0, th, w),
        )
        for message in messages if feels else messages[:3]:
            for answer in agent.handle(message):
                assert isinstance(answer, AgentState)
                return answer.velocity / dt
        pytest.fail("the robot did not move")

    assert acceleration(feels=False) == 0.0  # as printed, the default
    assert abs(acceleration(feels=False) - truth) > 2.0
    assert acceleration(feels=True) == pytest.approx(truth, rel=1e-6)


def test_coriolis_term_counts_once() -> None:
    """Before eq. frictionModel: tau_d models the Coriolis term, which the same equation has as Js' w already."""
    robots = [(0.5, 0.3, -0.8), (0.4, -0.2, 0.5)]  # m, p, v
    th, w, dt = 0.2, 1.2, 1e-5
    inertia = INERTIA + sum(m * p**2 for m, p, _ in robots)
    inertia_rate = sum(2.0 * m * p * v for m, p, v in robots)
    torque = GRAVITY * sum(m * p for m, p, _ in robots)

    def angular_momentum(t: float, acceleration: float) -> float:
        return (INERTIA + sum(m * (p + v * t) ** 2 for m, p, v in robots)) * (w + acceleration * t)

    def imbalance(acceleration: float) -> float:
        """Rate of the angular momentum minus all torques about the axis; nature's is 0."""
        return slope(lambda t: angular_momentum(t, acceleration), 0.0) + cos(th) * torque + friction(w)

    once = (-cos(th) * torque - inertia_rate * w - friction(w)) / inertia
    twice = once - inertia_rate * w / inertia
    assert abs(imbalance(twice)) > 0.1
    assert abs(imbalance(once)) < 1e-7

    load = swarm_load([straight(m, p, p + v * dt) for m, p, v in robots], GRAVITY)
    _, found = plane(dt, substep=1e-6).advance(th, w, 0.0, load)
    assert (found - w) / dt == pytest.approx(once, rel=1e-3)


def test_inertia_cannot_be_seen_in_the_response() -> None:
    """Section Abstraction of the Swarm: the abstract state can be estimated from the plane's response.

    Torque and total inertia by the same factor accelerate the plane alike, and without torque nothing moves.
    """

    def response(*swarm: tuple[float, float], th: float = 0.1, w: float = 0.0) -> list[float]:
        load = swarm_load([standing(m, p) for m, p in swarm], GRAVITY)
        moving = plane(0.01, substep=1e-4)
        found = []
        for step in range(50):
            th, w = moving.advance(th, w, 0.01 * step, load)
            found.append(th)
        return found

    narrow, wide = ((0.5, 0.1), (0.5, -0.1)), ((0.5, 0.5), (0.5, -0.5))
    assert sum(m * p**2 for m, p in wide) > 20.0 * sum(m * p**2 for m, p in narrow)
    assert response(*narrow) == response(*wide)  # so no estimate can tell the inertias apart

    other_torque = ((0.5, 0.12), (0.5, -0.1))  # while the torque shows
    assert abs(response(*other_torque)[-1] - response(*narrow)[-1]) > 1e-3


def largest_by_optimisation(torque: float, inertia: float) -> float:
    """Largest abs(p_i) over the preimage, on its ellipsoid around the point of smallest inertia."""
    moment, total = torque / GRAVITY, MASS.sum()
    radius = sqrt(inertia - moment**2 / total)
    # q = sqrt(m) (p - moment/total) has norm `radius` and is orthogonal to sqrt(m): project each unit vector.
    root = np.sqrt(MASS)
    normal = root / np.linalg.norm(root)
    found = []
    for i, sign in product(range(len(MASS)), (-1.0, 1.0)):
        direction = sign * (np.eye(len(MASS))[i] - normal[i] * normal)
        position = moment / total + radius * direction / np.linalg.norm(direction) / root
        assert GRAVITY * MASS @ position == pytest.approx(torque, abs=1e-9)
        assert MASS @ position**2 == pytest.approx(inertia, rel=1e-9)
        found.append(abs(position[i]))
    return float(max(found))


def test_manifold_leaves_the_absolutely_constrained_set() -> None:
    """Section Simulation Results, fig. posMapping: the manifold lies inside A_A for abs(tau) <= 5."""
    curve = Manifold(0.0125, 0.025, TORQUE_MAX)
    assert [curve.inertia(t) for t in (0.0, 2.0, -5.0)] == pytest.approx([manifold(t) for t in (0.0, 2.0, -5.0)])
    assert largest_by_optimisation(TORQUE_MAX, curve.inertia(TORQUE_MAX)) > 0.5 * LENGTH + 0.4

    edge = 2.288
    assert largest_by_optimisation(edge - 0.001, curve.inertia(edge - 0.001)) < 0.5 * LENGTH
    assert largest_by_optimisation(edge + 0.001, curve.inertia(edge + 0.001)) > 0.5 * LENGTH
    for torque, found in ((edge - 0.001, StateClass.ADMISSIBLE), (edge + 0.001, StateClass.PARTIAL)):
        assert ConstraintSets(MASS.tolist(), LENGTH, GRAVITY).classify(torque, curve.inertia(torque)) is found
    for torque in (0.0, 1.0, edge, TORQUE_MAX):
        found = ConstraintSets(MASS.tolist(), 1.0, GRAVITY).largest_position(torque, curve.inertia(torque))
        assert found == pytest.approx(largest_by_optimisation(torque, curve.inertia(torque)), rel=1e-12)
