"""Defaults, time, generation, warnings and extension of the scenario models."""

import math
import random
import subprocess
import sys
from dataclasses import FrozenInstanceError

import pytest
from pydantic import ValidationError

from swarmabs_config.model.agents import DoubleIntegratorAgent, Generate, SingleIntegratorAgent
from swarmabs_config.model.controllers import AriseConfig, LqrConfig, PdConfig
from swarmabs_config.model.scenario import Swarm
from swarmabs_config.scenario import Scenario, parse_scenario
from swarmabs_config.scenario.checks import spread
from swarmabs_config.scenario.loader import default_name
from swarmabs_core.faults import LossFault
from swarmabs_core.plant import Plane
from swarmabs_core.theory.constraint_sets import ConstraintSets
from swarmabs_core.trajectory import Constant, Sine

PAPER = (
    SingleIntegratorAgent(id=1, mass=0.3552, position=0.125),
    SingleIntegratorAgent(id=2, mass=0.3532, position=-0.125),
    DoubleIntegratorAgent(id=3, mass=0.6762, damping=0.6524, position=0.125),
    DoubleIntegratorAgent(id=4, mass=0.4596, damping=1.3258, position=-0.125),
)
HEAD = "schema: 1\nswarm: {generate: {single_integrator: 4}}\n"


def test_only_schema_and_robots_are_required() -> None:
    scenario = parse_scenario(HEAD, default_name="some_name")
    assert (scenario.name, scenario.duration, scenario.step, scenario.seed) == ("some_name", 30.0, 0.01, 1)
    plane = scenario.plane
    assert (plane.inertia, plane.length, plane.gravity, plane.substep) == (0.5, 1.0, 9.81, 0.001)
    assert plane.friction == (0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0)
    assert (plane.angle, plane.angular_velocity, plane.robot_gravity) == (0.1, 0.0, False)
    assert (plane.disturbance.amplitude, plane.disturbance.angular_frequency) == (0.0, 0.5)
    manifold = scenario.manifold
    assert (manifold.curvature, manifold.offset, manifold.torque_max) == (0.0125, 0.025, 5.0)
    assert scenario.controller == PdConfig(gains=(3.1623, 3.2859))
    gains = scenario.swarm.gains
    assert (gains.k, gains.kp, gains.kd, gains.ksd) == ((10.0, 10.0), (10.0, 10.0), (5.0, 5.0), 1.0)
    assert (scenario.limits.velocity, scenario.limits.force) == (math.inf, math.inf)
    assert (scenario.lockstep.on_stall, scenario.lockstep.stall_timeout) == ("fail", 5.0)
    assert scenario.faults == ()


def test_defaults_of_the_other_controllers() -> None:
    assert parse_scenario(HEAD + "controller: {type: lqr}").controller == LqrConfig(q=(10.0, 1.0), r=1.0)
    arise = parse_scenario(HEAD + "controller: {type: arise}").controller
    assert arise == AriseConfig(
        ks=1.0,
        alpha1=1.0,
        alpha2=2.0,
        beta=0.5,
        gamma=(10.0, 1.0, 1.0, 10.0),
        smoothing=0.03,
        adaptive_initial=(0.4566, 0.009, 0.01, 0.9),
        trajectory=Sine(amplitude=0.7, angular_frequency=0.0471238898038469),
    )
    constant = parse_scenario(HEAD + "controller: {type: arise, trajectory: {type: constant, angle: 0.2}}")
    assert isinstance(constant.controller, AriseConfig)
    assert constant.controller.trajectory == Constant(angle=0.2)


def test_type_of_a_controller_may_be_left_out() -> None:
    assert parse_scenario(HEAD + "controller: {gains: [1, 2]}").controller == PdConfig(gains=(1.0, 2.0))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1E+0", 1.0),
        (".5", 0.5),
        ("5.", 5.0),
        ("+2", 2.0),
        ("!!float 3", 3.0),
        ("1.5e2", 150.0),
    ],
)
def test_every_decimal_is_a_number(text: str, value: float) -> None:
    assert parse_scenario(HEAD + f"plane: {{inertia: {text}}}").plane.inertia == value


@pytest.mark.parametrize("word", ["yes", "no", "on", "off", "y", "2001-01-01", "1:30", "!!str 5", "'1e3'"])
def test_words_are_texts(word: str) -> None:
    assert parse_scenario(HEAD + f"name: {word}").name == word.removeprefix("!!str ").strip("'")


def test_negative_zero_is_zero() -> None:
    plane = parse_scenario(HEAD + "plane: {angle: -0.0, angular_velocity: -0, friction: [-0.0, 1, 1, 1, 1, 1]}").plane
    for value in (plane.angle, plane.angular_velocity, plane.friction[0]):
        assert math.copysign(1.0, value) == 1.0


# Time


@pytest.mark.parametrize(
    ("duration", "step", "duration_ns", "step_ns", "steps"),
    [
        (30.0, 0.01, 30_000_000_000, 10_000_000, 3000),
        (0.3, 0.1, 300_000_000, 100_000_000, 3),
        (2147483647.0, 1e-9, 2147483647 * 10**9, 1, 2147483647 * 10**9),
        (0.000000003, 0.000000001, 3, 1, 3),
        (1.1, 0.0011, 1_100_000_000, 1_100_000, 1000),
    ],
)
def test_time_is_exact(duration: float, step: float, duration_ns: int, step_ns: int, steps: int) -> None:
    scenario = Scenario(schema=1, swarm=Swarm(agents=PAPER), duration=duration, step=step)
    assert (scenario.duration_ns, scenario.step_ns, scenario.steps) == (duration_ns, step_ns, steps)
    assert scenario.period == step_ns / 1e9


@pytest.mark.parametrize(
    ("at", "step"),
    [(0.0, 0), (0.005, 0), (0.015, 2), (0.025, 2), (0.0150000001, 2), (0.0149999999, 1), (5.0, 500)],
)
def test_fault_step_is_the_nearest_and_the_even_one_of_two(at: float, step: int) -> None:
    assert Scenario(schema=1, swarm=Swarm(agents=PAPER)).fault_step(at) == step


# Robots


def test_listed_robots_come_in_order_of_their_ids() -> None:
    scenario = Scenario(schema=1, swarm=Swarm(agents=PAPER[::-1]))
    assert scenario.agents == PAPER
    assert scenario.swarm.agents == PAPER[::-1]
    assert scenario.resolved().swarm.agents == PAPER


def test_single_integrators_answer_like_double_ones() -> None:
    assert (PAPER[0].damping, PAPER[0].velocity) == (0.0, 0.0)
    text = HEAD.replace("generate: {single_integrator: 4}", "agents: [{robots}]")
    robots = (
        "{id: 1, kind: single_integrator, mass: 1, position: 0.1, velocity: 0.0}, "
        "{id: 2, kind: double_integrator, mass: 1, damping: 0, position: 0}"
    )
    agents = parse_scenario(text.replace("{robots}", robots)).agents
    assert agents[0] == SingleIntegratorAgent(id=1, mass=1.0, position=0.1)
    assert agents[1] == DoubleIntegratorAgent(id=2, mass=1.0, damping=0.0, position=0.0, velocity=0.0)


def test_generated_robots_are_frozen_for_all_time() -> None:
    # From a loop over random.Random(1).random() with a + (b - a) r written out.
    agents = Generate(single_integrator=2, double_integrator=2).agents()
    distance = 0.1165404556834342
    assert agents == (
        SingleIntegratorAgent(id=1, mass=0.3171821220562006, position=distance),
        SingleIntegratorAgent(id=2, mass=0.6737168684686163, position=-distance),
        DoubleIntegratorAgent(id=3, mass=0.6318873094883071, damping=0.7550690257394217, position=distance),
        DoubleIntegratorAgent(id=4, mass=0.4977175435459705, damping=0.9494910647887381, position=-distance),
    )


def test_generated_robots_have_the_inertia_of_the_papers_four() -> None:
    agents = Generate(single_integrator=100, double_integrator=100, seed=3).agents()
    assert math.fsum(agent.mass * agent.position**2 for agent in agents) == pytest.approx(0.0288, rel=1e-12)
    assert [agent.kind for agent in agents] == ["single_integrator"] * 100 + ["double_integrator"] * 100
    assert all(0.25 <= agent.mass <= 0.75 for agent in agents)


def test_generated_robots_depend_on_the_seed_only() -> None:
    generate = Generate(single_integrator=3, double_integrator=3, position=0.2, seed=9)
    state = random.getstate()
    assert generate.agents() == generate.agents()
    assert random.getstate() == state
    assert generate.agents() != Generate(single_integrator=3, double_integrator=3, position=0.2).agents()
    assert [agent.position for agent in generate.agents()] == [0.2, -0.2] * 3


def test_resolved_lists_what_was_generated() -> None:
    scenario = parse_scenario(HEAD)
    resolved = scenario.resolved()
    assert resolved.swarm.generate is None
    assert resolved.swarm.agents == scenario.agents == resolved.agents
    assert resolved.resolved() == resolved
    assert hash(resolved.resolved()) == hash(resolved)
    assert resolved.swarm.gains == scenario.swarm.gains


def test_robots_that_join_later_are_not_there_at_the_start() -> None:
    faults = "[{kind: join, at: 1, agent: 2}, {kind: join, at: 0.004, agent: 3}, {kind: kill, at: 0, agent: 3}]"
    scenario = parse_scenario(HEAD + f"faults: {faults}")
    assert [agent.id for agent in scenario.initial_agents] == [1, 3, 4]
    assert [agent.id for agent in scenario.agents] == [1, 2, 3, 4]


@pytest.mark.parametrize("offset", [0.0, 0.4, 1e6])
def test_spread_is_the_sum_over_pairs(offset: float) -> None:
    agents = [agent.model_copy(update={"position": agent.position + offset}) for agent in PAPER]
    s0, s3 = spread(agents)
    assert s0 == pytest.approx(sum(agent.mass**2 for agent in PAPER), rel=1e-15)
    pairs = [(a, b) for a in agents for b in agents if a.id < b.id]
    expected = sum((a.mass * b.mass * (a.position - b.position)) ** 2 for a, b in pairs)
    assert s3 == pytest.approx(expected, rel=1e-12)


# Warnings


def test_largest_position_is_attained() -> None:
    # Two robots: torque and inertia fix both positions.
    masses, positions = (0.5, 1.5), (0.4, -0.1)
    torque = 9.81 * sum(m * p for m, p in zip(masses, positions, strict=True))
    inertia = sum(m * p * p for m, p in zip(masses, positions, strict=True))
    assert ConstraintSets(masses, 1.0, 9.81).largest_position(torque, inertia) == pytest.approx(0.4, rel=1e-12)
    assert ConstraintSets(masses, 1.0, 9.81).largest_position(5.0, 0.0) == math.inf


def test_the_papers_manifold_leaves_the_set_it_should_stay_in() -> None:
    (warning,) = Scenario(schema=1, swarm=Swarm(agents=PAPER)).warnings()
    assert warning.startswith("manifold: from |tau| = 2.288 N m on, below torque_max = 5.0, some positions")
    short = parse_scenario(HEAD + "manifold: {torque_max: 1.5}")
    assert short.warnings() == ()


def test_underdamped_swarm_with_a_large_inertia() -> None:
    text = "schema: 1\nmanifold: {torque_max: 1}\nswarm: {gains: {kd: [5, KD]}, generate: {KIND: 200, position: 0.125}}"
    (warning,) = parse_scenario(text.replace("KD", "5").replace("KIND", "double_integrator")).warnings()
    assert warning.startswith("swarm.gains: Kd < 2 sqrt(Kp) lets the inertia, 1.5")
    assert "use a kd of at least 6.325, or smaller positions" in warning
    assert parse_scenario(text.replace("KD", "6.325").replace("KIND", "double_integrator")).warnings() == ()
    assert parse_scenario(text.replace("KD", "5").replace("KIND", "single_integrator")).warnings() == ()


def test_feedback_of_the_wrong_sign() -> None:
    scenario = parse_scenario(HEAD + "manifold: {torque_max: 1}\ncontroller: {type: pd, gains: [-3, 1]}")
    assert scenario.warnings() == ("controller.gains: k1 = -3.0 does not level the plane; use a positive gain",)


def test_faults_that_leave_too_few_robots() -> None:
    faults = ", ".join(
        f"{{kind: {kind}, at: {n}, agent: {n}}}" for n, kind in enumerate(("kill", "leave", "freeze"), 1)
    )
    scenario = parse_scenario(HEAD + f"manifold: {{torque_max: 1}}\nfaults: [{faults}]")
    assert scenario.warnings() == ("faults: from step 301 on only 1 robots are active; torque and inertia need two",)


@pytest.mark.parametrize(
    ("fault", "step"),
    [("leave, at: 2", 201), ("join, at: 2", 0), ("kill, at: 2", None), ("leave, at: 30", None)],
)
def test_faults_that_leave_too_little_weight(fault: str, step: int | None) -> None:
    text = f"manifold: {{torque_max: 1.9, curvature: 0}}\nfaults: [{{kind: {fault}, agent: 3}}]"
    found = [text for text in parse_scenario(HEAD + text).warnings() if text.startswith("faults: ")]
    assert [text.partition(" kg")[0] for text in found] == (
        [] if step is None else [f"faults: from step {step} on the robots present weigh 1.368"]
    )


# Python


def test_models_are_immutable_and_strict() -> None:
    scenario = Scenario(schema=1, swarm=Swarm(agents=PAPER))
    with pytest.raises(ValidationError, match="frozen"):
        scenario.seed = 2
    with pytest.raises(ValidationError, match="valid number"):
        Scenario(schema=1, swarm=Swarm(agents=PAPER), plane=Plane(inertia="0.5"))  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match="finite number"):
        Scenario(schema=1, swarm=Swarm(agents=PAPER), plane=Plane(inertia=math.nan))
    with pytest.raises(FrozenInstanceError):
        scenario.plane.inertia = 1.0  # type: ignore[misc]  # it is what is tried
    with pytest.raises(ValidationError, match=r"expected a mapping, found an object of type Plane; write \{type: pd"):
        Scenario(schema=1, swarm=Swarm(agents=PAPER), controller=Plane())  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match=r"listed twice; give every robot its own id, e\.g\. 2"):
        Scenario(schema=1, swarm=Swarm(agents=(PAPER[0], PAPER[0])))


def test_faults_can_be_built_directly() -> None:
    scenario = Scenario(schema=1, swarm=Swarm(agents=PAPER), faults=(LossFault(probability=0.5),))
    assert scenario.faults == (LossFault(probability=0.5),)


@pytest.mark.parametrize(
    ("stem", "name"),
    [
        ("pd_het_4", "pd_het_4"),
        ("my run", "my run"),
        (".x", "_.x"),
        ("a\nb\\c", "a_b_c"),
        ("", "_"),
        ("é" * 99, "é" * 60),
    ],
)
def test_default_names_are_names(stem: str, name: str) -> None:
    assert default_name(stem) == name
    assert parse_scenario(HEAD, default_name=name).name == name


def test_the_core_does_without_pydantic_and_scenarios_without_ros_and_numpy() -> None:
    code = (
        "import sys, swarmabs_core\n"
        "assert 'pydantic' not in sys.modules\n"
        "import swarmabs_config.scenario\n"
        "assert not {'rclpy', 'numpy'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(sys.path)})
