"""Masses above and below the axis: against the Lagrangian by SymPy, against SciPy, and at jumps of velocities."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from math import inf
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from tests.swarmabs_core.helpers import PERIOD_NS, agent_state, builtin

from swarmabs_config import configure
from swarmabs_config.theory import check_scenario, setting
from swarmabs_core import plant
from swarmabs_core.behaviours import Parent
from swarmabs_core.controllers import Arise
from swarmabs_core.elementary import cos, sin, sin_cos, tanh
from swarmabs_core.elementary_arrays import elementwise
from swarmabs_core.heights import CenterHeights
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import AgentState, Kind, PlaneState, Status
from swarmabs_core.models import PlaneConfig
from swarmabs_core.parameters import SettingError
from swarmabs_core.plant import HeightLoad, SwarmLoad
from swarmabs_core.realtime.plane import PlaneMotion, RealtimePlaneConfig
from swarmabs_core.theory.arise import error_gradient, reference_bounds
from swarmabs_run.simulation import simulate

sympy = pytest.importorskip("sympy")

G = 9.81
SMOOTH = plant.Friction(0.1, 3.0, 2.0, 0.2, 3.0, 1.0)
NONE = plant.Friction(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
Array = NDArray[np.float64]
Robot = tuple[float, float, float, float]
H = PERIOD_NS / 1e9


class Mover(NamedTuple):
    """A robot between two states, its velocity before them, and its height."""

    mass: float
    start: tuple[float, float]
    end: tuple[float, float]
    before: float
    height: float

    def at(self, t: float, period: float, order: int) -> float:
        spline = CubicHermiteSpline([0.0, period], *zip(self.start, self.end, strict=True))
        return float(spline(t, order))


MOVERS = (
    Mover(0.4, (0.12, 0.3), (0.2, -0.2), 0.3, 0.05),
    Mover(0.7, (-0.3, -0.1), (-0.1, 0.5), 0.2, 0.11),
    Mover(0.5, (0.05, 0.4), (0.13, 0.4), -0.3, -0.08),
)


def plane(**options: Any) -> plant.Plane:
    given = {"friction": SMOOTH, "mass": 1.5, "center_height": -0.1, "inertia": 0.5, "gravity": G}
    return plant.Plane(**{**given, **options})


def load_of(movers: Sequence[Mover], period: float) -> SwarmLoad:
    paths = [plant.hermite(r.mass, r.start, r.end, period) for r in movers]
    jumps = [r.start[1] - r.before for r in movers]
    height = plant.height_load(paths, [r.height for r in movers], jumps, period)
    return replace(plant.swarm_load(paths, G), height=height)


@cache
def lagrangian() -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return acceleration and angular momentum of a plane with three robots, from their kinetic and potential energy.

    The plane is a rod with its centre of mass at (0, h0) in its own frame, and moment J about the axis; robot i is a
    point at (p_i(t), h_i). Both are functions of J, M, h0, g, theta, w, torque, and of m, h, p, v and a of each robot.
    """
    t, inertia, mass, h0, g, torque = sympy.symbols("t J M above g torque")
    theta = sympy.Function("theta")(t)
    robots = [(*sympy.symbols(f"m{n} h{n}"), sympy.Function(f"p{n}")(t)) for n in range(3)]
    kinetic, potential = inertia * theta.diff(t) ** 2 / 2, mass * g * h0 * sympy.cos(theta)
    for m, h, p in robots:
        x = p * sympy.cos(theta) - h * sympy.sin(theta)
        y = p * sympy.sin(theta) + h * sympy.cos(theta)
        kinetic += m * (x.diff(t) ** 2 + y.diff(t) ** 2) / 2
        potential += m * g * y
    energy = kinetic - potential
    momentum = energy.diff(theta.diff(t))
    angle, rate, acceleration = sympy.symbols("angle rate acceleration")
    symbols = [sympy.symbols(f"q{n} v{n} a{n}") for n in range(3)]
    values = [(theta.diff(t, 2), acceleration), (theta.diff(t), rate), (theta, angle)]
    for (_, _, p), (q, v, a) in zip(robots, symbols, strict=True):
        values = [(p.diff(t, 2), a), (p.diff(t), v), (p, q), *values]
    equation = (momentum.diff(t) - energy.diff(theta) - torque).subs(values)
    solved = -equation.subs(acceleration, 0) / equation.diff(acceleration)
    given = [inertia, mass, h0, g, angle, rate, torque]
    for (m, h, _), moving in zip(robots, symbols, strict=True):
        given += [m, h, *moving]
    return sympy.lambdify(given, solved), sympy.lambdify(given, momentum.subs(values))


numbers = st.floats(-1.0, 1.0)
masses = st.floats(0.1, 2.0)
states = st.tuples(numbers, numbers)
movers = st.builds(Mover, masses, states, states, numbers, st.floats(-0.3, 0.3))


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(movers, movers, movers), st.floats(-1.4, 1.4), numbers, st.floats(0.0, 1.0), masses, st.floats(-0.2, 0.2)
)
def test_acceleration_and_momentum_are_those_of_the_lagrangian(
    robots: tuple[Mover, ...], angle: float, rate: float, s: float, mass: float, height: float
) -> None:
    period = 0.7
    acceleration, momentum = lagrangian()
    body = plane(mass=mass, center_height=height)
    load = load_of(robots, period)
    motion = plant.acceleration(body, period, load, 0.0, 0.25, (sin_cos, cos, tanh))
    known = (body.inertia, mass, height, G, angle)
    friction = SMOOTH.torque(rate) + 0.25
    moving = [x for r in robots for x in (r.mass, r.height, *(r.at(s * period, period, order) for order in range(3)))]
    assert motion(s, angle, rate) == pytest.approx(acceleration(*known, rate, -friction, *moving), abs=1e-9, rel=1e-9)
    before = [x for r in robots for x in (r.mass, r.height, r.start[0], r.before, 0.0)]
    after = [x for r in robots for x in (r.mass, r.height, *r.start, 0.0)]
    assert load.height is not None
    kicked = rate + load.height.impulse / (body.inertia + load.inertia[0] + load.height.inertia)
    assert momentum(*known, kicked, 0.0, *after) == pytest.approx(momentum(*known, rate, 0.0, *before), abs=1e-9)


def reference(start: tuple[float, float], body: plant.Plane, period: float, time: float) -> tuple[float, float]:
    """Solve the plane under `MOVERS`, whose velocities jump first, from the equations of the documentation."""

    def inertia(t: float) -> float:
        return body.inertia + sum(r.mass * (r.at(t, period, 0) ** 2 + r.height**2) for r in MOVERS)

    lever = sum(r.mass * r.height for r in MOVERS) + body.mass * body.center_height

    def rhs(t: float, x: Array) -> list[float]:
        th, w = x
        torque = G * sum(r.mass * r.at(t, period, 0) for r in MOVERS)
        rate = 2.0 * sum(r.mass * r.at(t, period, 0) * r.at(t, period, 1) for r in MOVERS)
        reaction = sum(r.mass * r.height * r.at(t, period, 2) for r in MOVERS)
        tau_d = body.disturbance.amplitude * np.sin(body.disturbance.angular_frequency * (time + t))
        tipping = -np.cos(th) * torque + G * lever * np.sin(th) + reaction
        return [w, (tipping - rate * w - body.friction.torque(w, np.tanh) - tau_d) / inertia(t)]

    kick = sum(r.mass * r.height * (r.start[1] - r.before) for r in MOVERS) / inertia(0.0)
    begin = start[0], start[1] + kick
    return tuple(solve_ivp(rhs, (0.0, period), begin, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1])


@pytest.mark.parametrize("disturbance", [plant.Disturbance(), plant.Disturbance(0.4, 5.0)])
def test_plane_under_raised_robots_agrees_with_scipy(disturbance: plant.Disturbance) -> None:
    body = plane(disturbance=disturbance)
    state = plant.PlaneDynamics(body, 0.2).advance(0.2, -0.3, 1.7, load_of(MOVERS, 0.2))
    assert state == pytest.approx(reference((0.2, -0.3), body, 0.2, 1.7), abs=1e-10)
    level = [mover._replace(height=0.0) for mover in MOVERS]
    assert state != pytest.approx(plant.PlaneDynamics(body, 0.2).advance(0.2, -0.3, 1.7, load_of(level, 0.2)), abs=1e-4)


def test_many_periods_at_once_have_the_bits_of_each() -> None:
    dynamics = plant.PlaneDynamics(plane(), 0.2)
    loads = [load_of([mover._replace(height=0.02 * n - 0.1) for mover in MOVERS], 0.2) for n in range(9)]
    heights = [load.height for load in loads if load.height is not None]
    columns = SwarmLoad(
        *(
            tuple(np.array(numbers) for numbers in zip(*(getattr(load, name) for load in loads), strict=True))  # type: ignore[arg-type]
            for name in ("torque", "inertia")
        ),
        HeightLoad(
            *(np.array([getattr(height, name) for height in heights]) for name in ("moment", "inertia")),  # type: ignore[arg-type]
            tuple(np.array(numbers) for numbers in zip(*(height.reaction for height in heights), strict=True)),  # type: ignore[arg-type]
            np.array([height.impulse for height in heights]),  # type: ignore[arg-type]
        ),
    )

    def circle(angles: Array) -> tuple[Array, Array]:
        return elementwise(sin, angles), elementwise(cos, angles)

    angles, rates = np.linspace(-0.4, 0.4, 9), np.linspace(0.5, -0.5, 9)
    functions = (circle, partial(elementwise, cos), partial(elementwise, tanh))
    together = dynamics.advance_each(angles, rates, np.zeros(9), columns, 0.1, functions)
    alone = [
        dynamics.advance(*state, 0.0, load, 0.1)
        for *state, load in zip(angles.tolist(), rates.tolist(), loads, strict=True)
    ]
    assert list(zip(*(values.tolist() for values in together), strict=True)) == alone


def kicked(impulse: float, angle: float, rate: float = 0.0, weight: float = 0.0) -> tuple[float, float]:
    """Move a plane with an end stop at 0.25 rad for 10 ms after an impulse, under the torque of a weight."""
    height = HeightLoad(0.0, 0.0, (0.0, 0.0), impulse)
    load = SwarmLoad((weight, 0.0, 0.0, 0.0), (0.0,) * 7, height)
    body = plant.Plane(inertia=0.5, friction=NONE, end_stop=0.25)
    return plant.PlaneDynamics(body, H).advance(angle, rate, 0.0, load)


def test_the_stop_absorbs_a_jerk_outwards_and_lets_go_at_one_inwards() -> None:
    assert kicked(0.1, 0.25, weight=-1.0) == (0.25, 0.0)
    assert kicked(-0.1, -0.25, weight=1.0) == (-0.25, 0.0)
    assert kicked(-0.1, 0.25) == pytest.approx((0.25 - 0.2 * H, -0.2), abs=1e-15)
    assert kicked(0.1, 0.2) == pytest.approx((0.2 + 0.2 * H, 0.2), abs=1e-15)


def config(*schedule: Change, heights: tuple[float, ...] = (0.1, 0.2, -0.3), **options: Any) -> PlaneConfig:
    given = {"members": (1, 2, 3), "period_ns": PERIOD_NS, "plane": plane(inertia=0.6), "schedule": schedule}
    return PlaneConfig(**{**given, **options}, robots=CenterHeights(heights))


def moving(step: int, without: tuple[int, ...] = ()) -> list[AgentState]:
    """Return two single integrators, of which the second turns round in each step, and a double integrator."""
    turning, place = (0.5, -0.2 + 0.5 * H) if step % 2 else (-0.5 if step else 0.0, -0.2)
    states = [
        agent_state(1, step, mass=0.5, position=0.1 + 0.3 * H * step, velocity=0.3 if step else 0.0),
        agent_state(2, step, mass=0.8, position=place, velocity=turning),
        agent_state(3, step, kind=Kind.DOUBLE_INTEGRATOR, mass=0.7, position=0.3 - 0.01 * step, velocity=1.0 - step),
    ]
    return [state for state in states if state.agent_id not in without]


def feed(node: Parent, states: Sequence[AgentState]) -> tuple[float, float]:
    *_, last = [answer for state in states for answer in node.handle(state)]
    assert isinstance(last, PlaneState)
    return last.angle, last.angular_velocity


def momentum(state: tuple[float, float], robots: Sequence[Robot]) -> float:
    """Return the angular momentum of the plane of `config` with robots, given by m, h, p and v."""
    inertia = 0.6 + sum(m * (p * p + h * h) for m, h, p, _ in robots)
    return inertia * state[1] - sum(m * h * v for m, h, _, v in robots)


def test_jumps_stops_and_departures_change_the_momentum_by_torques_only() -> None:
    """Without gravity, friction and disturbance it is constant, except for what a robot takes that leaves."""
    level = plane(inertia=0.6, friction=NONE, gravity=1e-300)
    heights = {1: 0.1, 2: 0.2, 3: -0.3}
    node = Parent(config(Change(2, 2, ChangeKind.KILL), Change(4, 1, ChangeKind.REMOVE), plane=level))

    def robots(step: int, *gone: int) -> list[Robot]:
        return [(s.mass, heights[s.agent_id], s.position, s.velocity) for s in moving(step, gone)]

    before = momentum(feed(node, moving(0)), robots(0))
    for step in (1, 2):
        state = feed(node, moving(step))
        assert momentum(state, robots(step)) == pytest.approx(before, abs=1e-12)
    dead = moving(2)[1].position
    for step in (3, 4):
        state = feed(node, moving(step, without=(2,)))
        there = [*robots(step, 2), (0.8, 0.2, dead, 0.0)]
        assert momentum(state, there) == pytest.approx(before, abs=1e-12)
    state = feed(node, moving(5, without=(1, 2)))
    first = moving(4)[0].position
    there = [*robots(5, 1, 2), (0.8, 0.2, dead, 0.0), (0.5, 0.1, first, 0.0)]
    assert momentum(state, there) == pytest.approx(before, abs=1e-12)
    after = [*robots(5, 1, 2), (0.8, 0.2, dead, 0.0)]
    left = momentum(state, after)
    state = feed(node, moving(6, without=(1, 2)))
    after = [*robots(6, 1, 2), (0.8, 0.2, dead, 0.0)]
    assert momentum(state, after) == pytest.approx(left, abs=1e-12)


def test_a_dead_robot_still_tips_the_plane_and_a_removed_one_does_not() -> None:
    """Robots at rest on the axis: only heights turn the plane, by g H sin th."""

    def still(step: int, *robots: int) -> list[AgentState]:
        return [agent_state(i, step, mass=0.5, position=0.0, velocity=0.0) for i in robots]

    def turned(*changes: Change, missing: tuple[int, ...] = ()) -> float:
        body = plant.Plane(inertia=0.5, friction=NONE, angle=0.2, gravity=G)
        node = Parent(config(*changes, heights=(0.1, 0.2, 0.3), plane=body))
        feed(node, still(0, 1, 2, 3))
        feed(node, still(1, *({1, 2, 3} - {*missing})))
        before = feed(node, still(2, *({1, 2, 3} - {*missing})))[1]
        return feed(node, still(3, *({1, 2, 3} - {*missing})))[1] - before

    def expected(*heights: float) -> float:
        inertia = 0.5 + sum(0.5 * h * h for h in heights)
        return G * 0.5 * sum(heights) * np.sin(0.2) / inertia * H

    assert turned() == pytest.approx(expected(0.1, 0.2, 0.3), rel=2e-2)
    assert turned(Change(0, 3, ChangeKind.KILL), missing=(3,)) == turned()
    assert turned(Change(0, 3, ChangeKind.REMOVE), missing=(3,)) == pytest.approx(expected(0.1, 0.2), rel=2e-2)


@pytest.mark.parametrize("passed", [1, 3])
def test_the_plane_in_real_time_moves_by_the_same_equation(passed: int) -> None:
    """The momentum of robots that jump is kept; SciPy's equation holds for what moves smoothly."""
    level = plane(inertia=0.6, friction=NONE, gravity=1e-300)
    heights = CenterHeights((0.1, 0.2, -0.3))
    motion = PlaneMotion(RealtimePlaneConfig(members=(1, 2, 3), plane=level, robots=heights))
    before, after = ({state.agent_id: state for state in moving(step)} for step in (1, 1 + passed))
    state = motion.advance((0.1, -0.2), before, after, passed, 0)

    def robots(states: dict[int, AgentState]) -> list[Robot]:
        return [(s.mass, (0.1, 0.2, -0.3)[i - 1], s.position, s.velocity) for i, s in states.items()]

    expected = momentum((0.1, -0.2), robots(before))
    assert momentum(state, robots(after)) == pytest.approx(expected, abs=1e-12)
    gone = after | {3: after[3]._replace(status=Status.LEFT)}
    assert motion.advance((0.1, -0.2), before, gone, passed, 0) == state, "the caller leaves out robots that left"


def test_without_heights_there_is_no_term_and_a_wrong_number_of_them_is_refused() -> None:
    assert config(heights=(0.0, 0.0, 0.0), plane=plane(center_height=0.0)).heights is None
    assert config(heights=(), plane=plane()).heights == {1: 0.0, 2: 0.0, 3: 0.0}
    assert config(plane=plane(mass=0.0)).heights == {1: 0.1, 2: 0.2, 3: -0.3}
    for make in (config, lambda heights: RealtimePlaneConfig(robots=CenterHeights(heights))):
        with pytest.raises(SettingError, match=r"2 heights for [34] members; give one for each member, or none"):
            make(heights=(0.1, 0.2))  # type: ignore[operator]


def test_an_infinite_motion_ends_as_ever() -> None:
    load = replace(load_of(MOVERS, 0.2), height=HeightLoad(0.0, 0.0, (inf, 0.0), 0.0))
    with pytest.raises(plant.RunError, match="not finite"):
        plant.PlaneDynamics(plane(), 0.2).advance(0.1, 0.0, 0.0, load)


def test_the_compensation_holds_the_weight_under_every_law() -> None:
    """At rest the swarm then needs g H tan th more than the law alone asks for, with and without an offset."""
    raised = (*(f"swarm.agents.{n}.center_height={0.02 * n}" for n in range(4)), "plane={mass: 2, center_height: 0.05}")
    for controller in ("{type: pd}", "{type: lqr}", "{type: arise, trajectory: {type: constant, angle: 0.1}}"):
        scenario = builtin("pd_het_4", *raised, f"controller={controller}")
        masses = {agent.id: agent.mass for agent in scenario.agents}
        moment = sum(mass * 0.02 * (number - 1) for number, mass in masses.items()) + 0.1
        for offset in (0.0, 0.05):
            asked = []
            for changed in ("false", "true"):
                compensating = builtin("pd_het_4", *raised, f"controller={controller}", COMPENSATION.format(changed))
                generator = configure.controller_config(compensating, recording_window=0).desired_states()
                desired = generator.advance(0, PlaneState(0, 0, 0.3, 0.2), offset=offset)[1]
                asked.append(desired.torque)
            assert asked[1] - asked[0] == pytest.approx(G * moment * np.tan(0.3), rel=1e-12)


COMPENSATION = "controller.height_compensation={}"


@pytest.mark.parametrize("compensated", [pytest.param("false", marks=pytest.mark.system), "true"])
def test_an_offset_is_reached_with_compensation_and_missed_by_the_weight_without(compensated: str) -> None:
    """PD without Coulomb friction at rest: k1 (th - offset) cos th = g H sin th."""
    options = [f"swarm.agents.{n}.center_height=0.03" for n in range(4)]
    options += ["plane={friction: [0, 1, 1, 0, 1, 1], mass: 1, center_height: 0.03}", "duration=40"]
    options += ["faults=[{at: 0.1, kind: reference, offset: 0.1}]", COMPENSATION.format(compensated)]
    scenario = builtin("pd_si_4", *options)
    run = simulate(scenario)
    weight = G * 0.03 * (1.0 + sum(agent.mass for agent in scenario.agents))
    angle = 0.1
    for _ in range(100):
        angle = 0.1 + (weight * np.tan(angle) / 3.1623 if compensated == "false" else 0.0)
    assert run.angle[-1] == pytest.approx(angle, abs=1e-6)
    assert run.abstract.torque[-1] == pytest.approx(weight * np.tan(angle), abs=1e-5)


@pytest.mark.system
def test_arise_absorbs_a_weight_that_it_does_not_know() -> None:
    options = [f"swarm.agents.{n}.center_height=0.03" for n in range(4)]
    options += ["plane={friction: [0, 1, 1, 0, 1, 1]}", "controller.trajectory={type: constant, angle: 0.1}"]
    scenario = builtin("arise_si_4", "duration=60", "plane.disturbance.amplitude=0", *options)
    run = simulate(scenario)
    assert run.angle[-1] == pytest.approx(0.1, abs=1e-6)
    weight = G * 0.03 * sum(agent.mass for agent in scenario.agents)
    assert run.abstract.torque[-1] == pytest.approx(weight * np.tan(0.1), abs=1e-5)


def failed(*options: str) -> set[str]:
    return {condition.name for _, condition in check_scenario(builtin("pd_si_4", *options)).failed}


def test_check_compares_the_gain_with_the_weight_and_the_reaction_with_the_bandwidth() -> None:
    """k1 th cot th is 3.12 N m at 0.2 rad; a weight of the plane alone does not react."""

    def weight(newton_metres: float) -> str:
        return f"plane={{mass: 1, inertia: 0.5, center_height: {newton_metres / 9.81}}}"

    assert "k1, heights" not in failed(weight(3.11))
    assert "k1, heights" in failed(weight(3.13))
    assert failed(weight(-3.0)) == set()
    assert not {"k1, heights", "heights, torque"} & failed(weight(3.13), COMPENSATION.format("true"))
    assert "heights, torque" in failed(weight(3.13), COMPENSATION.format("true"), "manifold.torque_max=0.6")
    assert not any("heights" in condition.name for condition in conditions())
    with pytest.raises(plant.RunError, match="angle is"):
        simulate(builtin("pd_si_4", weight(4.5), "plane.friction=[0, 1, 1, 0, 1, 1]"))


def conditions(*options: str) -> list[Any]:
    report = check_scenario(builtin("pd_si_4", *options))
    return [condition for theorem in report.groups for condition in theorem.conditions]


@pytest.mark.parametrize("lag", [0.0, 0.05])
def test_the_bandwidth_is_where_the_reaction_feeds_itself(lag: float) -> None:
    """The roots of (s + 50)^2 (T s + 1) = (h k2/(g I)) 2500 s by NumPy, just below and above the limit."""
    raised = [f"swarm.agents.{n}.center_height=0.05" for n in range(4)]
    (reaction,) = [c for c in conditions(*raised, f"swarm.actuator_lag={lag}") if c.name == "heights, reaction"]
    inputs = reaction.inputs
    gain = inputs["height"] * inputs["k2"] / (9.81 * inputs["inertia"])
    assert inputs["height"] == pytest.approx(0.05, rel=1e-12)
    assert reaction.corrected.value == pytest.approx(gain * inputs["bandwidth"])
    for factor, stable in ((0.999, True), (1.001, False)):
        loop = np.polymul([1.0, 100.0, 2500.0], [lag, 1.0] if lag else [1.0])
        roots = np.roots(np.polysub(loop, [2500.0 * factor / inputs["bandwidth"], 0.0]))
        assert bool((roots.real < 0.0).all()) == stable


def test_the_reacting_height_is_that_of_the_robots_that_carry_the_change_of_the_torque() -> None:
    """By the pseudo-inverse of the Jacobian (g m_i, 2 m_i p_i): sum m h v for a unit rate of the torque, times g."""
    values = {"center_height": (0.1, 0.07, 0.04, 0.01), "position": (0.2, 0.09, -0.02, -0.13)}
    options = [f"swarm.agents.{n}.{key}={value}" for key, four in values.items() for n, value in enumerate(four)]
    scenario = builtin("pd_si_4", *options)
    mass, place, height = (
        np.array([getattr(agent, name) for agent in scenario.agents]) for name in ("mass", "position", "center_height")
    )
    row = np.linalg.pinv(np.array([9.81 * mass, 2.0 * mass * place]))[:, 0]
    assert setting(scenario).reacting_height == pytest.approx(9.81 * float(mass * height @ row), rel=1e-10)


def test_arise_sees_the_weight_as_a_disturbance_along_the_reference() -> None:
    assert np.subtract(error_gradient(0.5, 24.0, 1.5, 2.0, 3.0), error_gradient(0.5, 24.0, 1.5, 2.0)) == pytest.approx(
        [-1.5 * 3.0, 3.0, 0.0]
    )
    plain, raised = (
        setting(builtin("arise_si_4", "duration=20", f"plane={{mass: 1, center_height: {height}}}"))
        for height in (0, 0.1)
    )
    level, above = (reference_bounds(each, each.law) for each in (plain, raised))  # type: ignore[arg-type]
    assert isinstance(raised.law, Arise)
    times = np.linspace(0.0, 20.0, 20001)
    angle, rate = np.array([raised.law.trajectory.derivatives(t)[:2] for t in times.tolist()]).T
    assert 0.0 < above.corrected - level.corrected <= 0.981 * np.abs(np.cos(angle) * rate).max() * 1.01
