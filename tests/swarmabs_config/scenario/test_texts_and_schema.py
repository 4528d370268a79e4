"""Canonical texts, the JSON Schema, and that no input does anything but load, and load back, or be refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from jsonschema import Draft202012Validator

from swarmabs_config.scenario import (
    ScenarioError,
    dump_scenario,
    json_schema,
    load_scenario,
    parse_scenario,
    warnings_of,
    yaml_tree,
)
from swarmabs_config.scenarios import builtin_scenarios

GIVEN = """
    {schema: 1, name: "on", duration: 2, step: 1e-5, seed: 7, lockstep: {on_stall: drop},
     limits: {force: 2}, controller: {type: arise, trajectory: {type: constant}},
     swarm: {agents: [{kind: double_integrator, id: 2, mass: 1, position: 0, damping: 0},
                      {kind: single_integrator, id: 1, mass: 1, position: 0.1}]},
     faults: [{agent: 1, at: 1, kind: kill}, {steps: 2, kind: delay}]}"""
FILLED = """
    {schema: 1, name: "on", duration: 2.0, step: 1.0e-05, seed: 7,
     plane: {inertia: 0.5, mass: 0.0, center_height: 0.0, length: 1.0, gravity: 9.81,
             friction: [0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0], substep: null,
             angle: 0.1, angular_velocity: 0.0, disturbance: {amplitude: 0.0, angular_frequency: 0.5},
             robot_gravity: false, end_stop: null, sensor: {noise: [0.0, 0.0], resolution: [0.0, 0.0]}},
     manifold: {curvature: 0.0125, offset: 0.025, torque_max: 5.0},
     controller: {type: arise, height_compensation: false, ks: 1.0, alpha1: 1.0, alpha2: 2.0, beta: 0.5,
                  gamma: [10.0, 1.0, 1.0, 10.0], smoothing: 0.03, adaptive_initial: [0.4566, 0.009, 0.01, 0.9],
                  trajectory: {type: constant, angle: 0.0}},
     swarm: {law: {type: paper}, gains: {k: [10.0, 10.0], kp: [10.0, 10.0], kd: [5.0, 5.0], ksd: 1.0},
             agents: [{id: 1, kind: single_integrator, mass: 1.0, position: 0.1, center_height: 0.0},
                      {id: 2, kind: double_integrator, mass: 1.0, damping: 0.0, position: 0.0, velocity: 0.0,
                       center_height: 0.0}],
             sensor: {noise: [0.0, 0.0], resolution: [0.0, 0.0]}, actuator_lag: 0.0},
     observer: {type: sum}, limits: {velocity: null, force: 2.0},
     coordination: central, links: {type: all, degree: 6, seed: 1, pairs: [], loss: 0.0, sensing: []},
     lockstep: {on_stall: drop, stall_timeout: 5.0},
     realtime: {broadcast_age_limit: 0.1, state_age_limit: 0.1, plane_age_limit: 0.1, clock_tolerance: 0.02,
                takeover_after: 0.04, lane_margin: 0.02, start: wait, quorum: null},
     faults: [{kind: kill, at: 1.0, agent: 1}, {kind: delay, from: 0.0, to: null, agents: null, steps: 2}]}"""
LINES = """\
schema: 1
name: "on"
duration: 2.0
step: 1.0e-05
seed: 7
plane:
  inertia: 0.5
  mass: 0.0
  center_height: 0.0
  length: 1.0
  gravity: 9.81
  friction: [0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0]
"""
HEAD = "schema: 1\nswarm: {generate: {single_integrator: 4}}\n"
SCHEMA = Draft202012Validator(json_schema())


def test_every_default_is_filled_in_and_names_are_quoted_where_needed() -> None:
    canonical = dump_scenario(parse_scenario(GIVEN))
    assert json.dumps(yaml.safe_load(canonical)) == json.dumps(yaml.safe_load(FILLED)), "in this order"
    assert canonical.startswith(LINES)
    assert (
        "  agents:\n    - {id: 1, kind: single_integrator, mass: 1.0, position: 0.1, center_height: 0.0}\n" in canonical
    )
    assert dump_scenario(parse_scenario(canonical)) == canonical == dump_scenario(parse_scenario(FILLED))
    for name in ("yes", "null", "1e5", "a: b", "ä 'quoted' \"name\"", "x#y", "1.5", "_"):
        text = dump_scenario(parse_scenario(HEAD, default_name=name))
        assert parse_scenario(text).name == yaml.safe_load(text)["name"] == name


@pytest.mark.parametrize("name", builtin_scenarios())
def test_texts_load_back_fit_the_schema_and_mean_the_same_to_other_readers(name: str) -> None:
    path = builtin_scenarios()[name]
    scenario = load_scenario(path)
    text = dump_scenario(scenario)
    again = parse_scenario(text)
    assert again == scenario.resolved()
    assert dump_scenario(again) == text
    expected = json.loads(again.model_dump_json(by_alias=True))
    del expected["swarm"]["generate"]
    assert yaml.safe_load(text) == expected
    assert SCHEMA.is_valid(expected)
    assert SCHEMA.is_valid(yaml.safe_load(path.read_text(encoding="utf-8")))


def fields(schema: object) -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(schema, dict):
        yield from schema.get("properties", {}).items()
        for part in schema.values():
            yield from fields(part)
    elif isinstance(schema, list):
        for part in schema:
            yield from fields(part)


def test_schema_is_of_2020_12_and_describes_every_field() -> None:
    schema = json_schema()
    Draft202012Validator.check_schema(schema)
    assert schema["$schema"] == Draft202012Validator.META_SCHEMA["$id"]
    assert json.loads(json.dumps(schema)) == schema
    assert [name for name, part in (*fields(schema), *schema["$defs"].items()) if not part["description"].strip()] == []  # type: ignore[attr-defined]


LISTED = "schema: 1\nswarm: {{agents: [{}, {{id: 2, kind: single_integrator, mass: 1, position: 0}}]}}"


def test_schema_accepts_what_loads_and_refuses_what_does_not_load() -> None:
    for text in (
        FILLED,
        HEAD + "controller: {gains: [1, 2]}",
        HEAD + "controller: {type: lqr, r: 2}",
        HEAD + "controller: {type: arise, trajectory: {amplitude: 0.2}}",
        HEAD.replace("4", "4, position: 0.2"),
        LISTED.format("{id: 1, kind: single_integrator, mass: 1, position: 0.1, velocity: 0}"),
    ):
        parse_scenario(text)
        assert SCHEMA.is_valid(yaml.safe_load(text)), text
    for text in (
        HEAD.replace("schema: 1", "schema: 2"),
        HEAD.replace("generate", "robots"),
        HEAD.replace("4", "4, position: far"),
        HEAD + "plane: {friction: [1]}",
        HEAD + "controller: {type: mpc}",
        HEAD + "controller: {q: [1, 1]}",
        HEAD + "controller: {type: pd, trajectory: {}}",
        HEAD + "controller: {type: arise, trajectory: {type: constant, amplitude: 1}}",
        HEAD + "faults: [{kind: kill, at: 1}]",
        HEAD + "faults: [{at: 1, agent: 1}]",
        LISTED.format("{id: 1, kind: single_integrator, mass: 1, position: 0.1, damping: 1}"),
        LISTED.format("{id: 1, kind: double_integrator, mass: 1, position: 0.1}"),
        LISTED.format("{id: 1, mass: 1, position: 0.1}"),
        "schema: 1\nswarm: {agents: [], generate: {}}",
    ):
        with pytest.raises(ScenarioError):
            parse_scenario(text)
        assert not SCHEMA.is_valid(yaml.safe_load(text)), text


@given(st.integers(1, 2**31 * 10**9 - 10**9))
def test_every_time_that_a_float_can_tell_is_exact(nanoseconds: int) -> None:
    seconds = nanoseconds / 10**9
    assume(len(str(nanoseconds).rstrip("0")) <= 15)
    text = f"schema: 1\nduration: {seconds!r}\nstep: {seconds!r}\nswarm: {{generate: {{single_integrator: 4}}}}"
    assert parse_scenario(text).duration_ns == nanoseconds


VALID = """\
schema: 1
name: pd_het_4          # comment
duration: 30.0
plane: {friction: [0.01, 1000, 700, 0.02, 1000, 1.0], angle: 0.1, disturbance: {amplitude: 0.0}}
controller:
  type: arise
  trajectory: {type: sine, amplitude: 0.7}
swarm:
  gains: &g {k: [10, 10], ksd: 1.0}
  agents:
    - {id: 1, kind: single_integrator, mass: 0.6, position: 0.125}
    - {id: 3, kind: double_integrator, mass: 0.6762, damping: 0.6524, position: -0.125, velocity: 0.0}
limits: {velocity: null}
faults: [{kind: loss, probability: .2}, {at: 5.0, kind: kill, agent: 3}]
"""
FRAGMENTS = [
    "", " ", "\n", "\t", "-", "- ", ":", ": ", "{", "}", "[", "]", ",", "#", "&g ", "*g", "!", "!!",
    "!!float ", "!!str ", "!!python/name:os.system ", "|\n", ">\n", "'", '"', "%", "@", "`", "---\n",
    "...\n", "? ", "<<: ", "null", "~", "true", "yes", "0", "1", "-1", "-0", "007", "0x1F", "1e999", "1e-999",
    "9" * 500, ".nan", "-.inf", "1:30", "\0", "\x1b", "\x7f", "\ufeff", "\u2028", "\x85", "\ud800",
    "\U0010ffff", "é", "\r", "agents", "generate: {single_integrator: 9}",
]  # fmt: skip
edits = st.lists(
    st.tuples(
        st.integers(0, len(VALID)), st.integers(0, 12), st.one_of(st.sampled_from(FRAGMENTS), st.text(max_size=6))
    ),
    min_size=1,
    max_size=4,
)


def edited(changes: list[tuple[int, int, str]]) -> str:
    text = VALID
    for start, length, new in changes:
        text = text[:start] + new + text[start + length :]
    return text


def refused(error: ScenarioError) -> ScenarioError:
    assert str(error).isprintable()
    assert error.problem
    assert error.remedy
    assert error.line is not None or error.source.startswith("--set ")
    return error


def loads_back(text: str, *overrides: str) -> bool:
    """Tell whether a text with overrides loads; it then loads back from its canonical text, and else is refused."""
    try:
        found = parse_scenario(text, source="f", overrides=overrides)
    except ScenarioError as exc:
        refused(exc)
        return False
    canonical = dump_scenario(found)
    again = parse_scenario(canonical)
    assert again == found.resolved()
    assert dump_scenario(again) == canonical
    assert all(warning.isprintable() for warning in warnings_of(found))
    return True


def plain(text: str, loader: yaml_tree.Loader) -> yaml_tree.Plain | ScenarioError:
    try:
        return yaml_tree.read_tree(text, "f", loader=loader).plain()
    except ScenarioError as exc:
        return refused(exc)


@given(edits)
@settings(max_examples=100)
def test_edited_files_load_or_are_refused_whatever_parser_reads_them(changes: list[tuple[int, int, str]]) -> None:
    text = edited(changes)
    loads_back(text)
    fast, slow = plain(text, yaml.CSafeLoader), plain(text, yaml.SafeLoader)
    assert fast == slow or ScenarioError in {type(fast), type(slow)}  # they differ in what they refuse


@given(st.text())
def test_any_text_is_refused(text: str) -> None:
    assert not loads_back(text)


@given(st.binary(max_size=60), st.integers(0, len(VALID)) | st.none())
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_bytes_load_or_are_refused(tmp_path: Path, data: bytes, start: int | None) -> None:
    path = tmp_path / "x.yaml"
    path.write_bytes(data if start is None else VALID.encode()[:start] + data + VALID.encode()[start:])
    try:
        load_scenario(path)
    except ScenarioError as exc:
        refused(exc)


numbers = st.sampled_from([0, 1, 2, 0.5, 1e-3, 1e-12, 1e12]) | st.floats(0, 1) | st.floats() | st.integers()
values = st.recursive(
    st.none() | st.booleans() | numbers | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
paths = st.sampled_from([
    "schema", "name", "duration", "step", "seed", "plane", "plane.friction", "plane.friction.1",
    "plane.inertia", "plane.substep", "plane.disturbance", "plane.end_stop", "manifold", "manifold.offset",
    "controller", "controller.type", "controller.gamma", "controller.gamma.0", "controller.adaptive_initial.1",
    "controller.trajectory", "controller.trajectory.type", "controller.trajectory.amplitude",
    "swarm", "swarm.gains.k.1", "swarm.sensor.noise.0", "swarm.actuator_lag",
    "swarm.agents", "swarm.agents.0", "swarm.agents.1.kind", "swarm.agents.1.velocity", "swarm.agents.2",
    "swarm.generate", "swarm.generate.position", "limits.force", "lockstep.on_stall", "lockstep.stall_timeout",
    "realtime.quorum", "faults", "faults.0", "faults.0.kind", "faults.0.agents", "faults.1.at", "faults.2",
])  # fmt: skip


@given(st.lists(st.tuples(paths, numbers | values | st.text(max_size=8)), min_size=1, max_size=3))
@settings(max_examples=100)
def test_any_override_is_taken_or_refused(changes: list[tuple[str, object]]) -> None:
    loads_back(VALID, *(f"{path}={value}" for path, value in changes))
