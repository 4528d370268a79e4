"""The scenarios that come with swarmabs, canonical texts, and the JSON Schema."""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from swarmabs_config.model.controllers import AriseConfig, PdConfig
from swarmabs_config.scenario import Scenario, dump_scenario, json_schema, load_scenario, parse_scenario
from swarmabs_core.trajectory import Sine

FOLDER = Path(__file__).parents[3] / "src" / "swarmabs_bringup" / "scenarios"
NAMES = [
    "pd_si_4",
    "pd_di_4",
    "pd_het_4",
    "arise_si_4",
    "arise_di_4",
    "arise_het_4",
    "arise_het_20",
    "arise_het_200",
]
MASSES = (0.3552, 0.3532, 0.6762, 0.4596)
DAMPINGS = (0.7290, 1.4133, 0.6524, 1.3258)


def built_in(name: str) -> Scenario:
    return load_scenario(FOLDER / f"{name}.yaml")


# The paper's runs


def test_there_are_the_papers_eight_runs() -> None:
    assert sorted(path.name for path in FOLDER.iterdir()) == sorted(f"{name}.yaml" for name in NAMES)
    assert all(built_in(name).name == name for name in NAMES)


@pytest.mark.parametrize("parent", ["pd", "arise"])
@pytest.mark.parametrize(("swarm", "singles"), [("si", 4), ("di", 0), ("het", 2)])
def test_four_robots(parent: str, swarm: str, singles: int) -> None:
    agents = built_in(f"{parent}_{swarm}_4").agents
    assert tuple(agent.id for agent in agents) == (1, 2, 3, 4)
    assert tuple(agent.mass for agent in agents) == MASSES
    assert tuple(agent.position for agent in agents) == (0.125, -0.125, 0.125, -0.125)
    assert all(agent.velocity == 0.0 for agent in agents)
    assert [agent.kind for agent in agents] == ["single_integrator"] * singles + ["double_integrator"] * (4 - singles)
    assert tuple(agent.damping for agent in agents) == (0.0,) * singles + DAMPINGS[singles:]


@pytest.mark.parametrize(("count", "duration", "inertia"), [(20, 70.0, 0.15), (200, 40.0, 0.0288)])
def test_larger_swarms(count: int, duration: float, inertia: float) -> None:
    scenario = built_in(f"arise_het_{count}")
    assert (
        [agent.kind for agent in scenario.agents].count("single_integrator") == count // 2 == len(scenario.agents) // 2
    )
    assert scenario.duration == duration
    assert math.fsum(a.mass * a.position**2 for a in scenario.agents) == pytest.approx(inertia, rel=0.1)
    assert [math.copysign(1, agent.position) for agent in scenario.agents] == [1, -1] * (count // 2)


@pytest.mark.parametrize("name", NAMES)
def test_parameters_of_the_paper(name: str) -> None:
    scenario = built_in(name)
    assert (scenario.step, scenario.plane.substep) == (0.01, 0.001)
    if name.startswith("pd"):
        assert scenario.controller == PdConfig(gains=(3.1623, 3.2859))
        assert (scenario.duration, scenario.plane.angle, scenario.plane.disturbance.amplitude) == (
            30.0,
            0.1,
            0.0,
        )
    else:
        assert scenario.controller == AriseConfig()
        assert (scenario.plane.angle, scenario.plane.disturbance.amplitude) == (0.075, 0.1)
        assert scenario.plane.disturbance.angular_frequency == 0.5
        assert Sine().angular_frequency == pytest.approx(0.015 * math.pi, rel=1e-14)


# Canonical texts

CANONICAL = """\
schema: 1
name: "on"
duration: 2.0
step: 1.0e-05
seed: 7
plane:
  inertia: 0.5
  length: 1.0
  gravity: 9.81
  friction: [0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0]
  substep: 0.001
  angle: 0.1
  angular_velocity: 0.0
  disturbance:
    amplitude: 0.0
    angular_frequency: 0.5
  robot_gravity: false
  end_stop: null
  sensor:
    noise: [0.0, 0.0]
    resolution: [0.0, 0.0]
manifold:
  curvature: 0.0125
  offset: 0.025
  torque_max: 5.0
controller:
  type: arise
  ks: 1.0
  alpha1: 1.0
  alpha2: 2.0
  beta: 0.5
  gamma: [10.0, 1.0, 1.0, 10.0]
  smoothing: 0.03
  adaptive_initial: [0.4566, 0.009, 0.01, 0.9]
  trajectory:
    type: constant
    angle: 0.0
swarm:
  law:
    type: paper
  gains:
    k: [10.0, 10.0]
    kp: [10.0, 10.0]
    kd: [5.0, 5.0]
    ksd: 1.0
  agents:
    - {id: 1, kind: single_integrator, mass: 1.0, position: 0.1}
    - {id: 2, kind: double_integrator, mass: 1.0, damping: 0.0, position: 0.0, velocity: 0.0}
  sensor:
    noise: [0.0, 0.0]
    resolution: [0.0, 0.0]
  actuator_lag: 0.0
observer:
  type: sum
limits:
  velocity: null
  force: 2.0
lockstep:
  on_stall: drop
  stall_timeout: 5.0
realtime:
  broadcast_age_limit: 0.1
  state_age_limit: 0.1
  plane_age_limit: 0.1
  clock_tolerance: 0.02
  lane_margin: 0.02
  start: wait
  quorum: null
faults:
  - {kind: kill, at: 1.0, agent: 1}
  - {kind: delay, from: 0.0, to: null, agents: null, steps: 2}
"""


def test_every_default_is_filled_in() -> None:
    text = """
        {schema: 1, name: "on", duration: 2, step: 1e-5, seed: 7, lockstep: {on_stall: drop},
         limits: {force: 2}, controller: {type: arise, trajectory: {type: constant}},
         swarm: {agents: [{kind: double_integrator, id: 2, mass: 1, position: 0, damping: 0},
                          {kind: single_integrator, id: 1, mass: 1, position: 0.1}]},
         faults: [{agent: 1, at: 1, kind: kill}, {steps: 2, kind: delay}]}"""
    assert dump_scenario(parse_scenario(text)) == CANONICAL
    assert dump_scenario(parse_scenario(CANONICAL)) == CANONICAL


@pytest.mark.parametrize("name", NAMES)
def test_texts_load_back(name: str) -> None:
    scenario = built_in(name)
    text = dump_scenario(scenario)
    again = parse_scenario(text)
    assert again == scenario.resolved()
    assert dump_scenario(again) == text


@pytest.mark.parametrize("name", NAMES)
def test_other_yaml_readers_read_the_same(name: str) -> None:
    scenario = built_in(name).resolved()
    expected = json.loads(scenario.model_dump_json(by_alias=True))
    del expected["swarm"]["generate"]
    assert yaml.safe_load(dump_scenario(scenario)) == expected


@pytest.mark.parametrize("name", ["yes", "null", "1e5", "a: b", "ä 'quoted' \"name\"", "x#y", "1.5", "_"])
def test_names_are_quoted_where_needed(name: str) -> None:
    scenario = parse_scenario("schema: 1\nswarm: {generate: {single_integrator: 4}}", default_name=name)
    assert parse_scenario(dump_scenario(scenario)).name == name
    assert yaml.safe_load(dump_scenario(scenario))["name"] == name


def test_the_largest_swarm_loads_back() -> None:
    text = "schema: 1\nswarm: {generate: {single_integrator: 5000, double_integrator: 5000}}"
    scenario = parse_scenario(text)
    assert parse_scenario(dump_scenario(scenario)) == scenario.resolved()


# JSON Schema


def in_range(value: float, schema: dict[str, Any]) -> bool:
    low, high = schema.get("minimum", -math.inf), schema.get("maximum", math.inf)
    above, below = schema.get("exclusiveMinimum", -math.inf), schema.get("exclusiveMaximum", math.inf)
    return bool(low <= value <= high and above < value < below)


def of_type(value: object, name: str | None) -> bool:
    match name:
        case "number":
            return isinstance(value, int | float) and not isinstance(value, bool)
        case "integer":
            return isinstance(value, int) and not isinstance(value, bool)
        case None:
            return True
    kinds: dict[str, type] = {
        "object": dict,
        "array": list,
        "string": str,
        "null": type(None),
        "boolean": bool,
    }
    return isinstance(value, kinds[name])


def fits(value: object, schema: dict[str, Any], root: dict[str, Any]) -> bool:
    """Say whether `value` fits, for the part of JSON Schema that is used here."""
    choices = [fits(value, choice, root) for choice in schema.get("oneOf", ())]
    checks = [
        "$ref" not in schema or fits(value, root["$defs"][schema["$ref"].removeprefix("#/$defs/")], root),
        value == schema.get("const", value),
        value in schema.get("enum", [value]),
        "oneOf" not in schema or choices.count(True) == 1,
        "anyOf" not in schema or any(fits(value, choice, root) for choice in schema["anyOf"]),
        of_type(value, schema.get("type")),
    ]
    if not all(checks):
        return False
    if isinstance(value, int | float):
        return in_range(value, schema)
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        return (
            (schema.get("additionalProperties", True) or value.keys() <= properties.keys())
            and value.keys() >= set(schema.get("required", ()))
            and all(fits(value[key], properties[key], root) for key in value.keys() & properties.keys())
        )
    if isinstance(value, list):
        items = schema.get("prefixItems", [schema.get("items", {})] * len(value))
        return schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf) and all(
            fits(item, part, root) for item, part in zip(value, items, strict=True)
        )
    return True


def fields(schema: object, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(schema, dict):
        for name, field in schema.get("properties", {}).items():
            yield f"{path}.{name}", field
        for key, part in schema.items():
            yield from fields(part, f"{path}.{key}")
    elif isinstance(schema, list):
        for index, part in enumerate(schema):
            yield from fields(part, f"{path}.{index}")


def test_schema_is_of_2020_12_and_describes_every_field() -> None:
    schema = json_schema()
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert json.loads(json.dumps(schema)) == schema
    undescribed = [path for path, field in fields(schema) if not field.get("description")]
    assert undescribed == []


@pytest.mark.parametrize("name", NAMES)
def test_built_in_scenarios_fit_the_schema(name: str) -> None:
    schema = json_schema()
    assert fits(yaml.safe_load((FOLDER / f"{name}.yaml").read_text()), schema, schema)
    assert fits(yaml.safe_load(dump_scenario(built_in(name))), schema, schema)


HEAD = "schema: 1\nswarm: {generate: {single_integrator: 4}}\n"


@pytest.mark.parametrize(
    "text",
    [
        CANONICAL,
        HEAD + "controller: {gains: [1, 2]}",
        HEAD + "controller: {type: lqr, r: 2}",
        HEAD + "controller: {type: arise, trajectory: {amplitude: 0.2}}",
        HEAD.replace("4", "4, position: 0.2"),
        (
            "schema: 1\nswarm: {agents: [{id: 1, kind: single_integrator, mass: 1, position: 0.1, velocity: 0}"
            ", {id: 2, kind: single_integrator, mass: 1, position: 0}]}"
        ),
    ],
)
def test_schema_accepts_what_loads(text: str) -> None:
    schema = json_schema()
    parse_scenario(text)
    assert fits(yaml.safe_load(text), schema, schema)


@pytest.mark.parametrize(
    "text",
    [
        HEAD.replace("schema: 1", "schema: 2"),
        HEAD.replace("generate", "robots"),
        HEAD.replace("4", "4, position: far"),
        HEAD + "plane: {angle: 2}",
        HEAD + "plane: {friction: [1]}",
        HEAD + "controller: {type: mpc}",
        HEAD + "controller: {q: [1, 1]}",
        HEAD + "controller: {type: pd, trajectory: {}}",
        HEAD + "controller: {type: arise, smoothing: 0}",
        HEAD + "controller: {type: arise, trajectory: {type: constant, amplitude: 1}}",
        HEAD + "faults: [{kind: kill, at: 1}]",
        HEAD + "faults: [{at: 1, agent: 1}]",
        HEAD + "lockstep: {on_stall: wait}",
        "schema: 1\nswarm: {agents: [{id: 1, kind: single_integrator, mass: 1, position: 0, damping: 1}]}",
        "schema: 1\nswarm: {agents: [{id: 1, kind: double_integrator, mass: 1, position: 0}]}",
        "schema: 1\nswarm: {agents: [{id: 1, mass: 1, position: 0}]}",
        "schema: 1\nswarm: {agents: [], generate: {}}",
    ],
)
def test_schema_refuses_what_does_not_load(text: str) -> None:
    schema = json_schema()
    assert not fits(yaml.safe_load(text), schema, schema)
