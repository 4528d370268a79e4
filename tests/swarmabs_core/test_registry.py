"""What installed packages bring: found when it is asked for, refused with its package's name when it is unfit."""

import importlib.metadata
import sys
from pathlib import Path

import pytest
from tests.plugin_packages import BANG_BANG, SCALED, install
from tests.swarmabs_core.helpers import digest

from swarmabs_config.scenario import Scenario, json_schema, parse_scenario
from swarmabs_config.theory import check_scenario
from swarmabs_core.controllers import CONTROLLERS, PD, ControllerType, ParentContext, ParentController, StateFeedback
from swarmabs_core.errors import InputError
from swarmabs_core.manifold import Manifold
from swarmabs_core.plant import Friction
from swarmabs_core.registry import PluginError, Registry
from swarmabs_core.swarm_law import LAWS
from swarmabs_run.simulation import simulate, simulated_steps
from swarmabs_run.vector_simulation import vectorised

Laws = Registry[ParentContext, ParentController]
CONTEXT = ParentContext(0.01, 0.5, Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0), Manifold(0.0125, 0.025, 5.0))
PART = "from swarmabs_core.controllers import ControllerType\nfrom swarmabs_core.parameters import Parameter\n"


@pytest.fixture
def registry() -> Laws:
    built_in = tuple(CONTROLLERS.built_in.values())
    group = "swarmabs.parent_controllers"
    return Registry("parent controller", group, ControllerType, built_in, ("torque", "reference"))


def test_what_a_package_brings_is_found_beside_the_built_in(packages: Path, registry: Laws) -> None:
    install(packages, "controller", "bang_bang", BANG_BANG)
    assert list(registry) == [*CONTROLLERS.built_in, "bang_bang"]
    assert len(registry) == len(CONTROLLERS.built_in) + 1
    assert registry["pd"] is PD
    assert registry["bang_bang"].settings[0].name == "torque"
    assert registry["bang_bang"] is registry["bang_bang"]
    assert registry.package("bang_bang") == ("test-bang-bang", "1.5")
    assert registry.package("pd") is None
    law = registry.make("bang_bang", {"torque": 0.25}, CONTEXT)
    assert law.torque_of == 0.25
    with pytest.raises(InputError, match=r"parameter torque: 3.0 is not allowed; give at most 2"):
        registry.make("bang_bang", {"torque": 3.0}, CONTEXT)


def test_installed_packages_are_not_looked_at_for_what_is_built_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: pytest.fail("they were searched"))
    scenario = parse_scenario(
        "{schema: 1, duration: 0.1, controller: {type: lqr}, swarm: {generate: {single_integrator: 2}}}",
        overrides=["controller.type=arise", "controller.gamma.0=5", "swarm.law.type=paper"],
    )
    assert len(simulate(scenario).step) == 11
    assert CONTROLLERS.package(scenario.controller.type) is LAWS.package(scenario.swarm.law.type) is None
    with pytest.raises(pytest.fail.Exception):
        json_schema()


def test_an_unknown_name_is_answered_with_all_names_and_loads_nothing(packages: Path, registry: Laws) -> None:
    install(packages, "controller", "broken", "raise RuntimeError", package="broken-one")
    with pytest.raises(InputError, match=r"no parent controller 'mpc'; available: arise, broken, lqr, pd, pid"):
        registry.find("mpc")
    assert "mpc" not in registry
    assert "broken" in registry
    assert "broken_one" not in sys.modules
    source = f"{PART}PART = ControllerType('idle', (), lambda settings, context: 7)"
    install(packages, "controller", "idle", source)
    with pytest.raises(PluginError, match=r"'idle' makes an object of type int, which has no method torque"):
        registry.make("idle", {}, CONTEXT)


UNFIT: dict[str, tuple[str, str]] = {
    "import": (
        "import no_such_module_anywhere",
        r"cannot be loaded: ModuleNotFoundError: No module named 'no_such_module_anywhere'; repair",
    ),
    "syntax": ("def (:", r"cannot be loaded: SyntaxError"),
    "nothing": ("OTHER = 1", r"cannot be loaded: AttributeError"),
    "wrong type": ("PART = 3", r"is an object of type int, not a ControllerType"),
    "wrong name": (f"{PART}PART = ControllerType('other', (), print)", r"is named 'other'; entry point and object"),
    "no make": (f"{PART}PART = ControllerType('unfit', (), None)", r"has no function make"),
    "no table": (f"{PART}PART = ControllerType('unfit', ('gain',), print)", r"settings that are not a tuple of Param"),
    "list": (
        f"{PART}PART = ControllerType('unfit', (Parameter('a', [1.0], 'x'),), print)",
        r"has a setting 'a' whose default is a list",
    ),
    "default out of bounds": (
        f"{PART}PART = ControllerType('unfit', (Parameter('a', -1.0, 'x', minimum=0.0),), print)",
        r"has a default outside its own bounds: parameter a: -1.0 is not allowed; give at least 0",
    ),
    **{
        name: (
            f"{PART}PART = ControllerType('unfit', ({settings},), print)",
            rf"has a setting '{name}', whose name is malformed",
        )
        for name, settings in {
            "a": "Parameter('a', 1.0, 'x'), Parameter('a', 2.0, 'x')",
            "type": "Parameter('type', 'x', 'x')",
            r"type\.a": "Parameter('type.a', 1.0, 'x')",
            r"a\.b": "Parameter('a', 1.0, 'x'), Parameter('a.b', 2.0, 'x')",
            "Gain 1": "Parameter('Gain 1', 1.0, 'x')",
        }.items()
    },
}


@pytest.mark.parametrize("case", UNFIT)
def test_an_unfit_package_is_named(packages: Path, registry: Laws, case: str) -> None:
    source, text = UNFIT[case]
    install(packages, "controller", "unfit", source, package="unfit-one")
    with pytest.raises(PluginError, match=text) as caught:
        registry.find("unfit")
    assert str(caught.value).startswith("parent controller 'unfit' (unfit_one:PART of package unfit-one 1.5) ")
    assert str(caught.value).endswith("; repair the package, or uninstall it")
    assert "\n" not in str(caught.value)


def test_two_packages_with_one_name_and_one_with_a_built_in_name_are_refused(packages: Path, registry: Laws) -> None:
    for package in ("first-one", "second-one"):
        install(packages, "controller", "bang_bang", BANG_BANG, package=package)
    said = r"provided by package first-one 1\.5 and package second-one 1\.5; uninstall all but one"
    with pytest.raises(PluginError, match=said):
        registry.find("bang_bang")
    install(packages, "controller", "pd", f"{PART}PART = ControllerType('pd', (), print)", package="usurper")
    assert isinstance(registry.make("pd", {}, CONTEXT), StateFeedback)
    for ask in (registry.__iter__, lambda: registry.find("mpc")):
        with pytest.raises(PluginError, match=r"package usurper 1\.5 provides a parent controller 'pd'"):
            list(ask())


KINDS = {
    "SI": "{single_integrator: 4}",
    "DI": "{double_integrator: 4}",
    "mixed": "{single_integrator: 2, double_integrator: 2}",
    "many": "{single_integrator: 4, double_integrator: 4}",
}
HALVED = {"k": "[5, 4]", "kp": "[8, 6]", "kd": "[3, 2]"}
"""Gains whose doubles are exact."""
DOUBLED = {"k": "[10, 8]", "kp": "[16, 12]", "kd": "[6, 4]"}


def scenario(kind: str, law: str, gains: dict[str, str]) -> Scenario:
    given = ", ".join(f"{name}: {value}" for name, value in gains.items())
    swarm = f"{{law: {law}, gains: {{{given}}}, generate: {KINDS[kind]}}}"
    return parse_scenario(f"{{schema: 1, duration: 0.2, swarm: {swarm}}}")


@pytest.mark.parametrize("kind", KINDS)
def test_a_law_that_doubles_the_gains_does_what_doubled_gains_do(packages: Path, kind: str) -> None:
    install(packages, "law", "scaled", SCALED)
    laws = {"{type: paper}": DOUBLED, "{type: scaled, factor: 2}": HALVED, "{type: scaled}": HALVED}
    plain, doubled, halved = (digest(simulated_steps(scenario(kind, law, gains))) for law, gains in laws.items())
    assert plain == doubled != halved
    assert vectorised(scenario("many", "{type: scaled}", {})) is None, "one that is not known on arrays"
    assert vectorised(scenario("many", "{type: paper}", {})) is not None


def test_no_theorem_is_about_another_law(packages: Path) -> None:
    install(packages, "law", "scaled", SCALED)
    assert any(one.applicable for one in check_scenario(scenario("SI", "{type: paper}", {})).theorems)
    report = check_scenario(scenario("SI", "{type: scaled}", {}))
    assert not report.covered and not any(one.applicable for one in report.theorems)
    assert any("not of scaled" in note for note in report.notes)
