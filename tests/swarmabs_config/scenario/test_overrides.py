"""Overrides ``a.b=v``: what they can set, and that their errors name them."""

import re
from operator import attrgetter

import pytest

from swarmabs_config.model.agents import Generate
from swarmabs_config.model.controllers import AriseConfig, LqrConfig, PdConfig
from swarmabs_config.scenario import Scenario, ScenarioError, parse_scenario
from swarmabs_core.faults import DelayFault, LossFault
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
UNTYPED = TEXT.replace("  type: pd\n", "")
SINE = ["controller.type=arise", "controller.beta=7", "controller.trajectory.amplitude=0.2"]
GENERATED = "schema: 1\nswarm: {generate: {single_integrator: 4}}\n"


def parse(*overrides: str, text: str = TEXT) -> Scenario:
    return parse_scenario(text, source="f", overrides=overrides)


@pytest.mark.parametrize(
    ("overrides", "field", "value"),
    [
        # Values of the file.
        (["name=other"], "name", "other"),
        (["duration=5"], "duration", 5.0),
        (["duration= 5e-1 "], "duration", 0.5),
        (["duration=5", "duration=6"], "duration", 6.0),
        (["controller.gains.1=7"], "controller", PdConfig(gains=(1.0, 7.0))),
        (["controller.gains=[3, 4]"], "controller", PdConfig(gains=(3.0, 4.0))),
        # What the file leaves out, also single elements of lists.
        (["plane.angle=0.2"], "plane.angle", 0.2),
        (["plane.angle=0.2", "plane={}"], "plane.angle", 0.1),
        (["plane.disturbance.amplitude=0.2"], "plane.disturbance.amplitude", 0.2),
        (["limits={force: 3}", "limits.velocity=2"], "limits.velocity", 2.0),
        (["plane.angle=0.2", "plane.end_stop=0.2"], "plane.end_stop", 0.2),
        (["plane.friction.5=2"], "plane.friction", (0.01, 1000.0, 700.0, 0.02, 1000.0, 2.0)),
        (["swarm.gains.kd.1=9"], "swarm.gains.kd", (5.0, 9.0)),
        # Another controller drops the keys of the file's; those that overrides have set stay.
        (["controller.type=lqr", "controller.q.0=5"], "controller", LqrConfig(q=(5.0, 1.0))),
        (["controller.type=lqr"], "controller", LqrConfig()),
        (["controller.type=pd"], "controller", PdConfig(gains=(1.0, 2.0))),
        (["controller={type: arise}"], "controller", AriseConfig()),
        (SINE, "controller", AriseConfig(beta=7.0, trajectory=Sine(amplitude=0.2))),
        (SINE[::-1], "controller", AriseConfig(beta=7.0, trajectory=Sine(amplitude=0.2))),
    ],
)
def test_what_is_set_holds(overrides: list[str], field: str, value: object) -> None:
    assert attrgetter(field)(parse(*overrides)) == value


def test_another_type_drops_the_keys_of_the_old_one() -> None:
    for text, override, controller in (
        (ARISE, "controller.type=pd", PdConfig()),
        (ARISE, "controller.trajectory.type=constant", AriseConfig(beta=3.0, trajectory=Constant())),
        (ARISE, "controller.trajectory.type=sine", AriseConfig(beta=3.0, trajectory=Sine(amplitude=0.3))),
        (UNTYPED, "controller.type=pd", PdConfig(gains=(1.0, 2.0))),
        (UNTYPED, "controller.type=lqr", LqrConfig()),
        (GENERATED, "controller.type=lqr", LqrConfig()),
    ):
        assert parse(override, text=text).controller == controller, (text, override)


def test_robots_and_faults() -> None:
    assert parse("swarm.agents.1.damping=0").agents[1].damping == 0.0
    assert parse("swarm.agents.1.position=-0.5").agents[1].position == -0.5, "the very end of the plane"
    appended = "swarm.agents.2={id: 9, kind: single_integrator, mass: 1, position: 0}"
    assert [agent.id for agent in parse(appended).agents] == [1, 2, 9]
    faults = parse("faults.0.kind=loss", "faults.0.probability=.5", "faults.1={kind: delay, steps: 1}").faults
    assert faults == (LossFault(probability=0.5), DelayFault(steps=1))
    generate = parse("swarm.generate.mass.1=0.9", text=GENERATED).swarm.generate
    assert generate == Generate(single_integrator=4, mass=(0.25, 0.9))
    given_way = parse("swarm.agents=null", "swarm.generate.double_integrator=6").agents
    assert [agent.kind for agent in given_way] == ["double_integrator"] * 6


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("duration", "not of the form path=value; write e.g. --set plane.angle=0.2"),
        ("=5", "not of the form path=value; write e.g."),
        ("plane..angle=5", "not of the form path=value; write e.g."),
        ("a." * 32 + "a=1", "the path has 33 parts; write e.g."),
        ("a." * 31 + "a=1", "a: unknown key 'a'"),
        ("plane.angel=1", "plane.angel: unknown key 'angel'; did you mean 'angle'?"),
        ("plane.angle=", "plane.angle: expected a number, found nothing (null); write"),
        ("plane.angle=.nan", ".nan is not a finite number; give a finite number"),
        ("plane.angle=[", "not valid YAML: while parsing a flow "),
        ("name=!!python/name:os.system x", "the tag 'tag:yaml.org,2002:pyt"),
        ("step=0.007", "step: the duration 30.0 s is not a multiple of the step 0.007 s (see line 2)"),
        ("duration.x=1", "duration: it is the number 30.0 and has no parts; set the whole"),
        ("controller.type=pdd", "controller.type: unknown type 'pdd'; did you mean 'pd'?"),
        ("controller.gains.2=1", "controller.gains: expected a list of 2 numbers, found"),
        ("controller.gains.3=1", "controller.gains: '3' is not an index of this list of 2; use 0 to 1, or 2 to append"),
        ("controller.gains.x=1", "controller.gains: 'x' is not an index of this list of 2; use"),
        ("faults.1={}", "faults: '1' is not an index of this list of 0; use 0 to append"),
        ("limits.0=1", "limits: it is not a list; set one of its keys, or the whole value"),
        ("swarm.agents=null", "swarm: no robots: neither 'agents' nor 'generate' is given"),
        ("swarm.generate.seed=1", "swarm: both 'agents' and 'generate' are given; keep one of them; '--set swarm.ag"),
        ("swarm.agents.0.id=2", "swarm.agents.0.id: robot 2 is listed twice (see line 9); give"),
        ("swarm.agents.0.position=-0.1", "swarm.agents: all robots are at one point"),
    ],
)
def test_errors_name_the_override(override: str, expected: str) -> None:
    with pytest.raises(ScenarioError, match="^" + re.escape(f"--set {override}: {expected}")) as caught:
        parse(override)
    assert str(caught.value).isprintable()


SET = "--set controller."
AT_ONE_POINT = ["swarm.agents.0.position=0.3", "swarm.agents.1.position=0.3"]


@pytest.mark.parametrize(
    ("text", "overrides", "expected"),
    [
        (TEXT, ["name=a\nb: c"], r"--set name=a\nb: c: not valid YAML: mapping values are not allowed"),
        (GENERATED, ["swarm.agents.0.mass=1"], "--set swarm.agents.0.mass=1: swarm.agents: the robots are generated"),
        (TEXT, AT_ONE_POINT, f"--set {AT_ONE_POINT[-1]}: swarm.agents: all robots are at one point"),
        (TEXT, ["controller.type=x", "controller.q.0=1"], f"{SET}q.0=1: controller.q: it is not a list; set"),
        (GENERATED + "controller: pd\n", ["controller.type=lqr"], f"{SET}type=lqr: controller: it is the t"),
        (TEXT.replace("gains:", "gain:"), ["controller.type=pd", "plane.angle=1"], "f:5: controller.gain: unknown key"),
    ],
)
def test_an_error_names_its_place_and_an_override_mends_a_file(text: str, overrides: list[str], expected: str) -> None:
    with pytest.raises(ScenarioError, match="^" + re.escape(expected)):
        parse(*overrides, text=text)
    assert parse("swarm.agents.0.mass=0.6", text=TEXT.replace("mass: 0.6", "mass: -0.6")) == parse()
