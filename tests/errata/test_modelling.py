"""Section Example Case and tab. PhysicalParameters: the plane, its friction, the abstract space."""

from dataclasses import replace
from itertools import product
from math import cos, sin, sqrt

import numpy as np
import pytest
from tests.errata.paper import FRICTION, GRAVITY, INERTIA, LENGTH, MASS, TORQUE_MAX, friction, manifold, slope
from tests.swarmabs_core.helpers import PERIOD_NS, broadcasts

from swarmabs_config import configure
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.behaviours import Agent
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import AgentState, PlaneState
from swarmabs_core.plant import Friction, Plane, PlaneDynamics, standing, straight, swarm_load
from swarmabs_core.theory.constraint_sets import ConstraintSets, StateClass

PAPER = Friction(*FRICTION)


def plane(period: float, substep: float = 1e-5) -> PlaneDynamics:
    return PlaneDynamics(Plane(inertia=INERTIA, friction=PAPER, substep=substep), period)


@pytest.mark.parametrize(
    ("time", "length", "printed"),
    [
        # In minutes, printed g2, g3, g5 in s^2 and g6 in N s; in centimetres, g1 and g4 in N and g6 in N s.
        (60.0, 1.0, (60.0**2, 60.0**-2, 60.0)),
        (1.0, 100.0, (100.0, 1.0, 100.0)),
    ],
    ids=["minutes", "centimetres"],
)
def test_units_of_the_friction(time: float, length: float, printed: tuple[float, float, float]) -> None:
    """tab. PhysicalParameters: with right units a formula gives the same torque whatever the units are."""
    w = 0.003  # rad/s, where all terms count
    truth = friction(w) * time**2 * length**2  # N m = kg m^2/s^2

    def torque(amplitude: float, steepness: float, viscous: float) -> float:
        """Friction in other units, each kind of parameter times what its unit becomes."""
        g1, g2, g3, g4, g5, g6 = FRICTION
        law = Friction(amplitude * g1, steepness * g2, steepness * g3, amplitude * g4, steepness * g5, viscous * g6)
        return law.torque(w * time)

    assert abs(torque(*printed) / truth - 1.0) > 0.2
    assert torque(time**2 * length**2, 1.0 / time, time * length**2) == pytest.approx(truth, rel=1e-12)  # N m, s/rad


def test_sizes_of_the_friction() -> None:
    """After eq. frictionModel: g4 <= g1 is demanded; the table violates it, and the friction still takes energy.

    lem. J_dot_is_bounded: abs(f_f) <= g1 + g6 abs(w), without g4.
    """
    assert not PAPER.g4 <= PAPER.g1
    speeds = np.logspace(-6, 1, 200).tolist()
    for g4 in (0.0, 0.5 * PAPER.g1, PAPER.g4, 10.0 * PAPER.g1):
        law = Friction(PAPER.g1, PAPER.g2, PAPER.g3, g4, PAPER.g5, PAPER.g6)
        assert min(sign * law.torque(sign * w) for w in speeds for sign in (1.0, -1.0)) > 0.0
    dt = 1e-7  # and the plane feels it
    for w in (1e-4, 1e-3, 0.01, 1.0):
        _, after = plane(dt).advance(0.0, w, 0.0, swarm_load([], GRAVITY))
        assert INERTIA * (w - after) / dt == pytest.approx(friction(w), rel=1e-5)

    assert friction(0.1) > PAPER.g1 + PAPER.g6 * 0.1 + 0.009
    assert all(PAPER.torque(w) <= PAPER.g1 + PAPER.g4 + PAPER.g6 * w for w in speeds)


def test_force_driven_robots_feel_the_plane() -> None:
    """eq. EOM_DI without command and damping says p'' = 0; Lagrange says m p'' = dL/dp."""
    m, p, th, w = 0.4, 0.2, 0.3, 1.5

    def lagrangian(x: float) -> float:
        return 0.5 * (INERTIA + m * x**2) * w**2 - m * GRAVITY * x * sin(th)

    truth = slope(lagrangian, p) / m
    assert abs(truth) > 2.0  # and not 0, as printed, which is the default
    config = replace(configure.agent_configs(find_scenario("pd_di_4"))[0], mass=m, position=p, damping=0.0)

    def velocity(*, feels: bool) -> float:
        agent = Agent(replace(config, feels_gravity=feels))
        agent.start()
        heard = (*broadcasts(), PlaneState(0, 0, th, w))[: 3 + feels]
        (state,) = [answer for message in heard for answer in agent.handle(message)]
        assert isinstance(state, AgentState)
        return state.velocity

    acceleration = (velocity(feels=True) - velocity(feels=False)) / (PERIOD_NS / 1e9)
    assert not config.feels_gravity
    assert acceleration == pytest.approx(truth, rel=1e-8)


def test_coriolis_term_counts_once() -> None:
    """Before eq. frictionModel: tau_d models the Coriolis term, which the same equation has as Js' w already."""
    robots = [(0.5, 0.3, -0.8), (0.4, -0.2, 0.5)]  # m, p, v
    th, w, dt = 0.2, 1.2, 1e-5
    load = swarm_load([straight(m, p, p + v * dt) for m, p, v in robots], GRAVITY)
    _, after = plane(dt, 1e-6).advance(th, w, 0.0, load)
    acceleration_of_run = (after - w) / dt
    torque = GRAVITY * sum(m * p for m, p, _ in robots)

    def angular_momentum(t: float, acceleration: float) -> float:
        return (INERTIA + sum(m * (p + v * t) ** 2 for m, p, v in robots)) * (w + acceleration * t)

    def imbalance(acceleration: float) -> float:
        """Rate of the angular momentum minus all torques about the axis; nature's is 0."""
        return slope(lambda t: angular_momentum(t, acceleration), 0.0) + cos(th) * torque + friction(w)

    twice = sum(2.0 * m * p * v for m, p, v in robots) * w / angular_momentum(0.0, 0.0) * w
    assert abs(imbalance(acceleration_of_run - twice)) > 0.1
    assert abs(imbalance(acceleration_of_run)) < 1e-3


def test_inertia_cannot_be_seen_in_the_response() -> None:
    """Section Abstraction of the Swarm: the abstract state can be estimated from the plane's response.

    Torque and total inertia by the same factor accelerate the plane alike, and without torque nothing moves.
    """

    def response(*swarm: tuple[float, float]) -> list[float]:
        load = swarm_load([standing(m, p) for m, p in swarm], GRAVITY)
        moving, th, w, angles = plane(0.01, 1e-4), 0.1, 0.0, []
        for step in range(50):
            th, w = moving.advance(th, w, 0.01 * step, load)
            angles.append(th)
        return angles

    narrow = response((0.5, 0.1), (0.5, -0.1))
    assert response((0.5, 0.5), (0.5, -0.5)) == narrow  # so no estimate can tell the inertias apart,
    assert abs(response((0.5, 0.12), (0.5, -0.1))[-1] - narrow[-1]) > 1e-3  # while the torque shows


def largest_by_optimisation(torque: float, inertia: float) -> float:
    """Largest abs(p_i) over the preimage, on its ellipsoid around the point of smallest inertia."""
    moment, total = torque / GRAVITY, MASS.sum()
    radius = sqrt(inertia - moment**2 / total)
    # q = sqrt(m) (p - moment/total) has norm `radius` and is orthogonal to sqrt(m): project each unit vector.
    root = np.sqrt(MASS)
    normal = root / np.linalg.norm(root)
    largest = []
    for i, sign in product(range(len(MASS)), (-1.0, 1.0)):
        direction = sign * (np.eye(len(MASS))[i] - normal[i] * normal)
        position = moment / total + radius * direction / np.linalg.norm(direction) / root
        assert (GRAVITY * MASS @ position, MASS @ position**2) == pytest.approx((torque, inertia), abs=1e-9)
        largest.append(abs(position[i]))
    return float(max(largest))


def test_manifold_leaves_the_absolutely_constrained_set() -> None:
    """Section Simulation Results, fig. posMapping: the manifold lies inside A_A for abs(tau) <= 5."""
    curve, sets = Manifold(0.0125, 0.025, TORQUE_MAX), ConstraintSets(MASS.tolist(), LENGTH, GRAVITY)
    edge = 2.288
    for torque, inside in ((0.0, True), (edge - 0.001, True), (edge + 0.001, False), (-TORQUE_MAX, False)):
        inertia = curve.inertia(torque)
        assert inertia == pytest.approx(manifold(torque))
        farthest = largest_by_optimisation(torque, inertia)
        assert (farthest < 0.5 * LENGTH) is inside
        assert sets.largest_position(torque, inertia) == pytest.approx(farthest, rel=1e-12)
        assert sets.classify(torque, inertia) is (StateClass.ADMISSIBLE if inside else StateClass.PARTIAL)
    assert largest_by_optimisation(TORQUE_MAX, curve.inertia(TORQUE_MAX)) > 0.5 * LENGTH + 0.4
