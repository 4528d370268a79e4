"""Defaults, time, generation, warnings and extension of the scenario models, and scenarios of older versions."""

import math
import random
import subprocess
import sys

import pytest
from pydantic import ValidationError

from swarmabs_config.model.agents import DoubleIntegratorAgent, Generate, SingleIntegratorAgent
from swarmabs_config.model.controllers import AriseConfig, LqrConfig, PdConfig
from swarmabs_config.model.scenario import Swarm
from swarmabs_config.scenario import PlaneScenario, ScenarioError, loader, parse_scenario, warnings_of
from swarmabs_config.scenario.checks import second_moments
from swarmabs_config.scenario.loader import default_name, upgraded
from swarmabs_config.scenario.yaml_tree import Plain
from swarmabs_core.plant import Plane
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
    assert scenario.controller == PdConfig(gains=(3.1623, 3.2859))
    assert (scenario.limits.velocity, scenario.limits.force) == (math.inf, math.inf)
    assert (scenario.lockstep.on_stall, scenario.faults) == ("fail", ())


@pytest.mark.parametrize(
    ("controller", "expected"),
    [
        ("{gains: [1, 2]}", PdConfig(gains=(1.0, 2.0))),
        ("{type: lqr}", LqrConfig(q=(10.0, 1.0), r=1.0)),
        ("{type: arise}", AriseConfig(trajectory=Sine(amplitude=0.7, angular_frequency=0.0471238898038469))),
        ("{type: arise, trajectory: {type: constant, angle: 0.2}}", AriseConfig(trajectory=Constant(angle=0.2))),
    ],
)
def test_what_a_controller_leaves_out_has_its_default(controller: str, expected: object) -> None:
    assert parse_scenario(HEAD + f"controller: {controller}").controller == expected


def test_every_decimal_is_a_number_negative_zero_is_zero_and_words_are_texts() -> None:
    decimals = {"1e-3": 0.001, "1E+0": 1.0, ".5": 0.5, "5.": 5.0, "+2": 2.0, "!!float 3": 3.0, "1.5e2": 150.0}
    for text, value in decimals.items():
        assert parse_scenario(HEAD + f"plane: {{inertia: {text}}}").plane.inertia == value, text
    plane = parse_scenario(HEAD + "plane: {angle: -0.0, angular_velocity: -0, friction: [-0.0, 1, 1, 1, 1, 1]}").plane
    for value in (plane.angle, plane.angular_velocity, plane.friction[0]):
        assert math.copysign(1.0, value) == 1.0
    for word in ("yes", "no", "on", "off", "y", "2001-01-01", "1:30", "!!str 5", "'1e3'"):
        assert parse_scenario(HEAD + f"name: {word}").name == word.removeprefix("!!str ").strip("'")


def test_time_is_exact_and_the_step_of_a_fault_the_nearest_and_the_even_one_of_two() -> None:
    for duration, step, duration_ns, step_ns, steps in (
        (30.0, 0.01, 30_000_000_000, 10_000_000, 3000),
        (0.3, 0.1, 300_000_000, 100_000_000, 3),
        (2147483647.0, 1e-9, 2147483647 * 10**9, 1, 2147483647 * 10**9),
        (0.000000003, 0.000000001, 3, 1, 3),
        (1.1, 0.0011, 1_100_000_000, 1_100_000, 1000),
    ):
        scenario = PlaneScenario(schema=1, swarm=Swarm(agents=PAPER), duration=duration, step=step)
        assert (scenario.duration_ns, scenario.step_ns, scenario.steps) == (duration_ns, step_ns, steps)
        assert scenario.period == step_ns / 1e9
    of_faults = {0.0: 0, 0.005: 0, 0.015: 2, 0.025: 2, 0.0150000001: 2, 0.0149999999: 1, 1.015: 102, 5.0: 500}
    scenario = PlaneScenario(schema=1, swarm=Swarm(agents=PAPER))
    assert {at: scenario.fault_step(at) for at in of_faults} == of_faults


def test_listed_robots_come_in_order_of_their_ids_and_single_integrators_answer_like_double_ones() -> None:
    scenario = PlaneScenario(schema=1, swarm=Swarm(agents=PAPER[::-1]))
    assert scenario.agents == PAPER
    assert scenario.swarm.agents == PAPER[::-1]
    assert scenario.resolved().swarm.agents == PAPER
    assert (PAPER[0].damping, PAPER[0].velocity) == (0.0, 0.0)
    robots = (
        "{id: 1, kind: single_integrator, mass: 1, position: 0.1, velocity: 0.0}, "
        "{id: 2, kind: double_integrator, mass: 1, damping: 0, position: 0}"
    )
    assert parse_scenario(f"schema: 1\nswarm: {{agents: [{robots}]}}").agents == (
        SingleIntegratorAgent(id=1, mass=1.0, position=0.1),
        DoubleIntegratorAgent(id=2, mass=1.0, damping=0.0, position=0.0, velocity=0.0),
    )


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


def test_as_many_robots_as_there_are_ids_can_be_generated() -> None:
    assert Generate(single_integrator=65535).single_integrator == 65535


def test_generated_robots_have_the_inertia_of_the_papers_four_and_depend_on_the_seed_only() -> None:
    generate = Generate(single_integrator=100, double_integrator=100, seed=3)
    agents, state = generate.agents(), random.getstate()
    assert math.fsum(agent.mass * agent.position**2 for agent in agents) == pytest.approx(0.0288, rel=1e-12)
    assert all(0.25 <= agent.mass <= 0.75 for agent in agents)
    assert generate.agents() == agents
    assert random.getstate() == state
    placed = generate.model_copy(update={"seed": 9, "position": 0.2}).agents()
    assert [agent.position for agent in placed] == [0.2, -0.2] * 100
    assert not {agent.mass for agent in placed} & {agent.mass for agent in agents}


def test_resolved_lists_what_was_generated_and_robots_that_join_later_are_not_there_at_the_start() -> None:
    scenario = parse_scenario(HEAD)
    resolved = scenario.resolved()
    assert resolved == scenario.model_copy(update={"swarm": resolved.swarm})
    assert (resolved.swarm.generate, resolved.swarm.agents) == (None, scenario.agents)
    assert resolved.resolved() == resolved and hash(resolved.resolved()) == hash(resolved)
    faults = "[{kind: join, at: 1, agent: 2}, {kind: join, at: 0.004, agent: 3}, {kind: kill, at: 0, agent: 3}]"
    scenario = parse_scenario(HEAD + f"faults: {faults}")
    assert [agent.id for agent in scenario.initial_agents] == [1, 3, 4]
    assert [agent.id for agent in scenario.agents] == [1, 2, 3, 4]


@pytest.mark.parametrize("offset", [0.0, 0.4, 1e6])
def test_spread_is_the_sum_over_pairs(offset: float) -> None:
    agents = [agent.model_copy(update={"position": agent.position + offset}) for agent in PAPER]
    s0, s3 = second_moments(agents)
    assert s0 == pytest.approx(sum(agent.mass**2 for agent in PAPER), rel=1e-15)
    pairs = [(a, b) for a in agents for b in agents if a.id < b.id]
    expected = sum((a.mass * b.mass * (a.position - b.position)) ** 2 for a, b in pairs)
    assert s3 == pytest.approx(expected, rel=1e-12)


def test_a_warning_of_an_underdamped_swarm_and_feedback_of_the_wrong_sign() -> None:
    text = "schema: 1\nmanifold: {torque_max: 1}\nswarm: {gains: {kd: [5, KD]}, generate: {KIND: 200, position: 0.125}}"
    (warning,) = warnings_of(parse_scenario(text.replace("KD", "5").replace("KIND", "double_integrator")))
    assert warning.startswith("swarm.gains: with Kd < 2 sqrt(Kp) the inertia, 1.5")
    assert "use a kd of at least 6.325, or smaller positions" in warning
    assert warnings_of(parse_scenario(text.replace("KD", "6.325").replace("KIND", "double_integrator"))) == ()
    assert warnings_of(parse_scenario(text.replace("KD", "5").replace("KIND", "single_integrator"))) == ()
    scenario = parse_scenario(HEAD + "manifold: {torque_max: 1}\ncontroller: {type: pd, gains: [-3, 1]}")
    assert warnings_of(scenario) == ("controller.gains: k1 = -3.0 does not level the plane; use a positive gain",)


def test_a_warning_of_faults_that_leave_too_few_robots_or_too_little_weight() -> None:
    ends = [f"{{kind: {kind}, at: {n}, agent: {n}}}" for n, kind in enumerate(("kill", "leave", "freeze"), 1)]
    scenario = parse_scenario(HEAD + f"manifold: {{torque_max: 1}}\nfaults: [{', '.join(ends)}]")
    (warning,) = warnings_of(scenario)
    assert warning.startswith("faults: from step 301 on, the number of active robots is 1; ")
    for fault, steps in (
        ("leave, at: 2", [201]),
        ("join, at: 2", [0]),
        ("kill, at: 2", []),
        ("leave, at: 30", []),
        ("leave, at: 29.99", [3000]),
    ):
        text = f"manifold: {{torque_max: 1.9, curvature: 0}}\nfaults: [{{kind: {fault}, agent: 3}}]"
        found = [text.partition(" kg")[0] for text in warnings_of(parse_scenario(HEAD + text)) if text[:7] == "faults:"]
        assert found == [f"faults: from step {step} on, the robots present weigh 1.368" for step in steps]


def test_models_are_immutable_and_strict() -> None:
    scenario = PlaneScenario(schema=1, swarm=Swarm(agents=PAPER))
    with pytest.raises(ValidationError, match="frozen"):
        scenario.seed = 2
    for plane in (Plane(inertia="0.5"), Plane(inertia=math.nan)):  # type: ignore[arg-type]
        with pytest.raises(ValidationError, match=r"valid number|finite number"):
            PlaneScenario(schema=1, swarm=Swarm(agents=PAPER), plane=plane)
    with pytest.raises(ValidationError, match=r"expected a mapping, found an object of type Plane; write \{type: pd"):
        PlaneScenario(schema=1, swarm=Swarm(agents=PAPER), controller=Plane())  # type: ignore[arg-type]


def test_default_names_are_names() -> None:
    stems = {"my run": "my run", ".x": "_.x", "a\nb\\c": "a_b_c", "": "_", "é" * 99: "é" * 60}
    stems["a" * 59 + " b"] = "a" * 59
    for stem, name in stems.items():
        assert default_name(stem) == name
        assert parse_scenario(HEAD, default_name=name).name == name


def test_scenarios_need_neither_ros_nor_numpy() -> None:
    code = "import sys, swarmabs_config.scenario; assert not {'rclpy', 'numpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(sys.path)})


def test_scenarios_of_made_up_versions_go_through_all_that_came_after_them_before_they_are_checked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def rename(data: dict[str, Plain]) -> dict[str, Plain]:
        return {("plate" if key == "plane" else key): value for key, value in data.items()}

    def double(data: dict[str, Plain]) -> dict[str, Plain]:
        return {**data, "duration": [data["duration"]] * 2}

    newest = {"schema": 3, "plate": 7, "duration": [3, 3]}
    for old in ({"schema": 1, "plane": 7, "duration": 3}, {"schema": 2, "plate": 7, "duration": 3}):
        before = dict(old)
        assert upgraded(old, (rename, double)) == newest  # type: ignore[arg-type]
        assert old == before
    for version in (3, 4, 0, -1, True, "1", None, 1.0):  # no older version
        data: dict[str, Plain] = {"schema": version, "duration": 3}
        assert upgraded(data, (rename, double)) is data
    monkeypatch.setattr(loader, "upgraded", rename)
    with pytest.raises(ScenarioError, match=r": plate: unknown key"):
        parse_scenario(HEAD + "plane: {angle: 0.2}")
