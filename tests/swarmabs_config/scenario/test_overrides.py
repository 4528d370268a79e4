"""Overrides ``a.b=v``: what they can set, and that their errors name them."""

from pathlib import Path

import pytest

from swarmabs_config.model.agents import Generate
from swarmabs_config.model.controllers import AriseConfig, LqrConfig, PdConfig
from swarmabs_config.scenario import Scenario, ScenarioError, load_scenario, parse_scenario
from swarmabs_core.faults import LossFault
from swarmabs_core.trajectory import Constant, Sine

TEXT = """\
schema: 1
duration: 30.0
controller:
  type: pd
  gains: [1, 2]
swarm:
  agents:
    - {id: 1, kind: single_integrator, mass: 0.6, position: 0.1}
    - {id: 2, kind: double_integrator, mass: 0.7, damping: 1, position: -0.1}
"""
ARISE = TEXT.replace("type: pd\n  gains: [1, 2]", "type: arise\n  beta: 3\n  trajectory: {amplitude: 0.3}")
GENERATED = "schema: 1\nswarm: {generate: {single_integrator: 4}}\n"


def parse(*overrides: str, text: str = TEXT) -> Scenario:
    return parse_scenario(text, source="f", overrides=overrides)


def test_a_value_of_the_file() -> None:
    assert parse("duration=5").duration == 5.0
    assert parse("duration= 5e-1 ").duration == 0.5
    assert parse("swarm.agents.1.damping=0").agents[1].damping == 0.0
    assert parse("controller.gains.1=7").controller == PdConfig(gains=(1.0, 7.0))
    assert parse("controller.gains=[3, 4]").controller == PdConfig(gains=(3.0, 4.0))


def test_a_value_that_the_file_leaves_out() -> None:
    assert parse("plane.angle=0.2").plane.angle == 0.2
    assert parse("plane.disturbance.amplitude=0.2").plane.disturbance.amplitude == 0.2
    assert parse("limits={force: 3}", "limits.velocity=2").limits.velocity == 2.0


def test_an_element_of_a_list_that_the_file_leaves_out() -> None:
    assert parse("plane.friction.5=2").plane.friction == (0.01, 1000.0, 700.0, 0.02, 1000.0, 2.0)
    assert parse("swarm.gains.kd.1=9").swarm.gains.kd == (5.0, 9.0)
    generate = parse("swarm.generate.mass.1=0.9", text=GENERATED).swarm.generate
    assert generate == Generate(single_integrator=4, mass=(0.25, 0.9))
    lqr = parse("controller.type=lqr", "controller.q.0=5").controller
    assert lqr == LqrConfig(q=(5.0, 1.0))


def test_elements_are_appended() -> None:
    robot = "{id: 9, kind: single_integrator, mass: 1, position: 0}"
    assert [agent.id for agent in parse(f"swarm.agents.2={robot}").agents] == [1, 2, 9]
    faults = parse("faults.0.kind=loss", "faults.0.probability=.5", "faults.1={kind: delay, steps: 1}").faults
    assert faults[0] == LossFault(probability=0.5)


def test_the_last_override_counts() -> None:
    assert parse("duration=5", "duration=6").duration == 6.0
    assert parse("plane.angle=0.2", "plane={}").plane.angle == 0.1


def test_another_controller_drops_the_keys_of_the_old_one() -> None:
    assert parse("controller.type=lqr").controller == LqrConfig()
    assert parse("controller.type=pd").controller == PdConfig(gains=(1.0, 2.0))
    assert parse("controller.type=pd", text=ARISE).controller == PdConfig()
    assert parse("controller={type: arise}").controller == AriseConfig()
    untyped = TEXT.replace("  type: pd\n", "")
    assert parse("controller.type=pd", text=untyped).controller == PdConfig(gains=(1.0, 2.0))
    assert parse("controller.type=lqr", text=untyped).controller == LqrConfig()
    assert parse("controller.type=lqr", text=GENERATED).controller == LqrConfig()


@pytest.mark.parametrize("order", [1, -1])
def test_keys_set_by_overrides_stay_in_either_order(order: int) -> None:
    overrides = ["controller.type=arise", "controller.beta=7", "controller.trajectory.amplitude=0.2"]
    assert parse(*overrides[::order]).controller == AriseConfig(beta=7.0, trajectory=Sine(amplitude=0.2))


def test_another_trajectory_drops_the_keys_of_the_old_one() -> None:
    controller = parse("controller.trajectory.type=constant", text=ARISE).controller
    assert controller == AriseConfig(beta=3.0, trajectory=Constant())
    controller = parse("controller.trajectory.type=sine", text=ARISE).controller
    assert controller == AriseConfig(beta=3.0, trajectory=Sine(amplitude=0.3))


def test_listed_robots_give_way_to_generated_ones() -> None:
    scenario = parse("swarm.agents=null", "swarm.generate.double_integrator=6")
    assert [agent.kind for agent in scenario.agents] == ["double_integrator"] * 6


def test_name_and_file(tmp_path: Path) -> None:
    path = tmp_path / "levelling.yaml"
    path.write_text(TEXT)
    assert load_scenario(path).name == "levelling"
    assert load_scenario(path, ["name=other"]).name == "other"


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("duration", "--set duration: not of the form path=value; write e.g. --set plane.angle=0.2"),
        ("=5", "--set =5: not of the form path=value; write e.g."),
        ("plane..angle=5", "--set plane..angle=5: not of the form path=value; write e.g."),
        ("a." * 32 + "a=1", "--set " + "a." * 32 + "a=1: a path of 33 parts; write e.g."),
        ("plane.angel=1", "--set plane.angel=1: plane.angel: unknown key 'angel'; did you mean 'angle'?"),
        ("plan.angle=1", "--set plan.angle=1: plan: unknown key 'plan'; did you mean 'plane'?"),
        ("plane.angle=x", "--set plane.angle=x: plane.angle: expected a number, found the text 'x'; write"),
        ("plane.angle=", "--set plane.angle=: plane.angle: expected a number, found nothing (null); write"),
        ("plane.angle=.nan", "--set plane.angle=.nan: .nan is not a finite number; give a finite number"),
        ("plane.angle=[", "--set plane.angle=[: not valid YAML: while parsing a flow "),
        (
            "name=!!python/name:os.system x",
            "--set name=!!python/name:os.system x: the tag 'tag:yaml.org,2002:pyt",
        ),
        ("name=a\nb: c", "--set name=a\\nb: c: not valid YAML: mapping values are not allowed"),
        (
            "step=0.007",
            "--set step=0.007: step: the duration 30.0 s is not a multiple of the step 0.007 s (see line 2)",
        ),
        (
            "duration.x=1",
            "--set duration.x=1: duration: it is the number 30.0 and has no parts; set the whole",
        ),
        (
            "controller.type=pid",
            "--set controller.type=pid: controller.type: unknown type 'pid'; did you mean 'pd'?",
        ),
        (
            "controller.gains.2=1",
            "--set controller.gains.2=1: controller.gains: expected a list of 2 numbers, found",
        ),
        (
            "controller.gains.3=1",
            "--set controller.gains.3=1: controller.gains: '3' is no index of this list of 2; use",
        ),
        (
            "controller.gains.x=1",
            "--set controller.gains.x=1: controller.gains: 'x' is no index of this list of 2; use",
        ),
        ("faults.1={}", "--set faults.1={}: faults: '1' is no index of this list of 0; use 0 to append"),
        ("limits.0=1", "--set limits.0=1: limits: it is not a list; set one of its keys, or the whole value"),
        (
            "swarm.agents=null",
            "--set swarm.agents=null: swarm: no robots: neither 'agents' nor 'generate' is given",
        ),
        (
            "swarm.generate.seed=1",
            (
                "--set swarm.generate.seed=1: swarm: both 'agents' and 'generate' are given; "
                "keep one of them; '--set swarm.agents=null' removes one"
            ),
        ),
        (
            "swarm.agents.0.id=2",
            "--set swarm.agents.0.id=2: swarm.agents.0.id: robot 2 is listed twice (see line 9); give",
        ),
        (
            "swarm.agents.0.position=-0.1",
            "--set swarm.agents.0.position=-0.1: swarm.agents: the robots stand at one point",
        ),
    ],
)
def test_errors_name_the_override(override: str, expected: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse(override)
    assert str(caught.value).startswith(expected)
    assert str(caught.value).isprintable()


def test_generated_robots_cannot_be_set_one_by_one() -> None:
    with pytest.raises(ScenarioError) as caught:
        parse("swarm.agents.0.mass=1", text=GENERATED)
    assert str(caught.value) == (
        "--set swarm.agents.0.mass=1: swarm.agents: the robots are not listed one by one; "
        "list them, or set parts of swarm.generate"
    )


def test_an_element_of_a_controller_that_is_not_known() -> None:
    with pytest.raises(ScenarioError, match=r"^--set controller\.q\.0=1: controller\.q: it is not a list; set one"):
        parse("controller.type=x", "controller.q.0=1")


def test_a_type_for_what_is_no_mapping() -> None:
    text = GENERATED + "controller: pd\n"
    with pytest.raises(ScenarioError, match=r"controller: it is the text 'pd' and has no parts; set the whole value"):
        parse("controller.type=lqr", text=text)


def test_an_error_of_the_file_names_the_file() -> None:
    with pytest.raises(ScenarioError, match=r"^f:5: controller\.gain: unknown key 'gain'"):
        parse("controller.type=pd", "plane.angle=0.2", text=TEXT.replace("gains:", "gain:"))


def test_an_override_can_mend_the_file() -> None:
    broken = TEXT.replace("mass: 0.6", "mass: -0.6")
    assert parse("swarm.agents.0.mass=0.6", text=broken) == parse()
