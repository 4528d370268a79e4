"""Scenarios with what installed packages bring: the declared settings are fields like all others."""

import re
from pathlib import Path
from typing import Any

import pytest
from tests.plugin_packages import BANG_BANG, SCALED, install

from swarmabs_bag.attached import provenance
from swarmabs_bag.run_folder import RunFolder
from swarmabs_config.configure import agent_configs, controller_settings, parent_controller
from swarmabs_config.model.controllers import CONTROLLER_CONFIGS
from swarmabs_config.scenario import Scenario, ScenarioError, dump_scenario, json_schema, parse_scenario
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.parameters import resolve
from swarmabs_run.orchestration.plan import plan

NUMBERS = {"torque": 0.1, "copy": 3, "pair": (1.0, 2.0), "many": (1, 2, 3), "inner.a": 0.5, "inner.deep.b": 1.5}
DEFAULTS = {**NUMBERS, "mode": "hard", "label": "x", "on": True, "words": ()}


@pytest.fixture(autouse=True)
def bang_bang(packages: Path) -> None:
    install(packages, "controller", "bang_bang", BANG_BANG)
    install(packages, "law", "scaled", SCALED)


def parse(controller: str = "{type: bang_bang}", *overrides: str, law: str = "{type: scaled}") -> Scenario:
    text = f"schema: 1\ncontroller: {controller}\nswarm:\n  law: {law}\n  generate: {{double_integrator: 2}}\n"
    return parse_scenario(text, source="f", overrides=overrides)


def test_what_is_left_out_has_the_declared_default_and_settings_reach_controller_and_nodes() -> None:
    scenario = parse()
    assert scenario.controller.type == "bang_bang"
    assert controller_settings(scenario) == DEFAULTS
    assert agent_configs(scenario)[0].law_settings == {"factor": 1.0, "bad_mass": 0.0}
    scenario = parse("{type: bang_bang, torque: 1, inner: {deep: {b: 7}}, words: [a, b c], on: false}").resolved()
    expected = {**DEFAULTS, "torque": 1.0, "inner.deep.b": 7.0, "words": ("a", "b c"), "on": False}
    assert controller_settings(scenario) == expected
    assert parent_controller(scenario).torque_of == 1.0  # type: ignore[attr-defined]
    processes = plan(scenario, RunFolder(Path("run")))
    given = {name: value for process in processes for name, value in process.parameters.items()}
    assert {name: given[f"controller.{name}"] for name in expected} == expected
    assert (given["controller.type"], given["law.type"], given["law.factor"]) == ("bang_bang", "scaled", 1.0)
    table = CONTROLLERS.find("bang_bang").settings
    assert resolve(table, controller_settings(scenario), owner="x") == expected
    scenario = parse("{type: bang_bang, torque: 0.3, many: [4], words: [on, x y], copy: 5}")
    text = dump_scenario(scenario)
    assert "\n  copy: 5\n" in text
    assert parse_scenario(text) == scenario.resolved()
    assert dump_scenario(parse_scenario(text)) == text


def test_overrides_reach_into_settings() -> None:
    assert controller_settings(parse("{type: bang_bang}", "controller.pair.1=9"))["pair"] == (1.0, 9.0)
    assert controller_settings(parse("{type: bang_bang}", "controller.inner.deep.b=9"))["inner.deep.b"] == 9.0
    assert controller_settings(parse("{type: pd, gains: [1, 2]}", "controller.type=bang_bang")) == DEFAULTS
    assert parse("{type: bang_bang, torque: 1}", "controller.type=pd").controller == CONTROLLER_CONFIGS["pd"]()
    scaled = parse("{type: pd}", "swarm.law.factor=2").swarm.law
    assert scaled.model_dump(by_alias=True) == {"type": "scaled", "factor": 2.0, "bad_mass": 0.0}
    assert parse("{type: pd}", "swarm.law.type=paper", law="{type: scaled, factor: 3}").swarm.law.type == "paper"


@pytest.mark.parametrize(
    ("controller", "expected"),
    [
        ("{type: bang_bang, torqe: 1}", "f:2: controller.torqe: unknown key 'torqe'; did you mean 'torque'?"),
        ("{type: bang_bang, torque: 0}", "f:2: controller.torque: 0 is out of range; give a number > 0"),
        ("{type: bang_bang, torque: 3}", "f:2: controller.torque: 3 is out of range; give a number <= 2"),
        ("{type: bang_bang, copy: 0}", "f:2: controller.copy: 0 is out of range; give a number >= 1"),
        ("{type: bang_bang, mode: sof}", "f:2: controller.mode: expected 'hard' or 'soft', found the text 'sof'; did"),
        ("{type: bang_bang, on: 1}", "f:2: controller.on: expected true or false"),
        ('{type: bang_bang, label: "a\\nb"}', r"f:2: controller.label: 'a\nb' contains unprintable characters"),
        ("{type: bang_bang, pair: [1]}", "f:2: controller.pair: expected a list of 2 numbers, found a list of 1"),
        ("{type: bang_bang, pair: [1, -1]}", "f:2: controller.pair.1: -1 is out of range; give a number >= 0"),
        ("{type: bang_bang, many: []}", "f:2: controller.many: expected a list of at least one value"),
        ("{type: bang_bang, inner: {c: 1}}", "f:2: controller.inner.c: unknown key 'c'; known: a, deep"),
        ("{type: bang_bank}", "f:2: controller.type: unknown type 'bang_bank'; did you mean 'bang_bang'?"),
    ],
)
def test_mistakes_are_answered_like_those_in_built_in_parts(controller: str, expected: str) -> None:
    with pytest.raises(ScenarioError, match="^" + re.escape(expected)):
        parse(controller)


PICKY = """
    from swarmabs_core.controllers import ControllerType
    from swarmabs_core.errors import InputError
    from swarmabs_core.parameters import SettingError
    from swarmabs_core.swarm_law import SwarmLaw


    def refuse(settings, known):
        raise {error}


    PART = {kind}("{name}", (), refuse)
"""


def test_an_unfit_package_and_what_a_package_refuses_are_errors_before_anything_starts(packages: Path) -> None:
    install(packages, "law", "broken", "raise RuntimeError('no\\nlicence')", package="broken-one")
    expected = "^f:4: swarm.law.type: swarm law 'broken' .*broken-one 1.5.*: no licence; repair the package, or uninst"
    with pytest.raises(ScenarioError, match=expected):
        parse(law="{type: broken}")
    for kind, name, error, said in (
        ("ControllerType", "picky", "InputError('too steep', 'lower it')", "2: controller: too steep; lower it"),
        ("ControllerType", "picky2", "SettingError('k.1', 'no', 'more')", "2: controller.k.1: no; more"),
        ("SwarmLaw", "picky3", "InputError('no')", "4: swarm.law: no; see the documentation of its package"),
    ):
        group = "law" if kind == "SwarmLaw" else "controller"
        install(packages, group, name, PICKY.format(name=name, kind=kind, error=error))
        with pytest.raises(ScenarioError, match=f"^f:{re.escape(said)}$"):
            parse(**{group: f"{{type: {name}}}"})


def test_the_schema_offers_what_is_installed() -> None:
    schema = json_schema()
    models = schema["properties"]["controller"]["oneOf"]  # type: ignore[index]
    names = [model["properties"]["type"]["const"] for model in models]
    assert names == [*CONTROLLERS.built_in, "bang_bang"]
    fields = models[-1]["properties"]
    assert fields["torque"]["exclusiveMinimum"] == 0.0
    assert (fields["torque"]["maximum"], fields["torque"]["default"]) == (2.0, 0.1)
    assert fields["torque"]["description"] == "torque, N m"
    assert fields["mode"]["enum"] == ["hard", "soft"]
    assert models[-1]["required"] == ["type"]
    assert models[-1]["additionalProperties"] is False


def test_the_bag_names_the_packages() -> None:
    def named(scenario: Scenario) -> dict[str, str]:
        versions: Any = provenance(scenario, driver="simulate")["versions"]
        return {name: version for name, version in versions.items() if name.startswith("test-")}

    assert named(parse()) == {"test-bang-bang": "1.5", "test-scaled": "1.5"}
    assert named(parse("{type: pd}", law="{type: paper}")) == {}


def test_the_reference_of_a_law_without_offset_cannot_be_offset(packages: Path) -> None:
    offset = "faults=[{kind: reference, at: 1, offset: 0.1}]"
    refused = r"faults\.0: the reference of controller 'bang_bang' cannot be offset \(see line 2\); remove"
    with pytest.raises(ScenarioError, match=refused):
        parse("{type: bang_bang}", offset)
    method = """
        def offset_torque(self, time, plane, offset):
            return self.torque(time, plane._replace(angle=plane.angle - offset))

        def reference(self, time):"""
    source = BANG_BANG.replace("bang_bang", "bang_bong").replace("\n        def reference(self, time):", method)
    install(packages, "controller", "bang_bong", source)
    parse("{type: bang_bong}", offset)
