"""Every declared setting: its bounds hold in a scenario's file and schema, for ``--set`` and for a node's parameter."""

import math
import re
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any, NamedTuple

import pytest
import yaml
from jsonschema import Draft202012Validator

from swarmabs_config.model.fields import LARGEST, SMALLEST
from swarmabs_config.scenario import ScenarioError, json_schema, parse_scenario
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.declaration import LONGEST_TIME, Part, Setting, entries_of, setting_of
from swarmabs_core.errors import InputError
from swarmabs_core.faults import FAULTS
from swarmabs_core.manifold import Manifold
from swarmabs_core.models.plane_robot import RobotConfig
from swarmabs_core.parameters import Parameter
from swarmabs_core.parent_response import ParentResponse
from swarmabs_core.plant import Plane
from swarmabs_core.realtime.base import Realtime
from swarmabs_core.robot_controller import Limits
from swarmabs_core.sensing import RobotSensor
from swarmabs_core.settings import Lockstep, Run
from swarmabs_core.swarm_law import SwarmGains
from swarmabs_core.trajectory import Constant, QuinticStep, Sine

SCHEMA = Draft202012Validator(json_schema())
ROBOTS = [
    {"id": 1, "kind": "double_integrator", "mass": 0.5, "damping": 1.0, "position": 0.1, "velocity": 0.0},
    {"id": 2, "kind": "single_integrator", "mass": 0.5, "position": -0.1},
    {"id": 3, "kind": "single_integrator", "mass": 0.5, "position": 0.0},
]
TREE: dict[str, Any] = {"schema": 1, "swarm": {"agents": ROBOTS}}
PARTS: dict[str, type] = {
    "plane": Plane,
    "manifold": Manifold,
    "swarm.gains": SwarmGains,
    "swarm.sensor": RobotSensor,
    "limits": Limits,
    "lockstep": Lockstep,
    "realtime": Realtime,
}


class Place(NamedTuple):
    """A setting at its path in a scenario, as a node and as a file have it."""

    tree: dict[str, Any]
    path: str
    parameter: Parameter
    in_file: Parameter
    time: bool


def settings(declaration: type, path: str) -> Iterator[tuple[str, Setting]]:
    """Yield all settings of a declaration and of its parts, each with its path."""
    for name, _, declared in entries_of(declaration):
        below = f"{path}.{name}" if name else path
        if isinstance(declared, Part):
            yield from settings(declared.declaration, below)
        elif isinstance(declared, Setting):
            yield below, declared


def found(tree: dict[str, Any], path: str, declared: Setting) -> Place:
    named = replace(declared.parameter, name=path)
    return Place({**TREE, **tree}, path, named, declared.in_file, declared.whole_nanoseconds)


def places() -> Iterator[Place]:
    yield found({}, "seed", setting_of(Run, "seed"))
    yield found({}, "swarm.actuator_lag", setting_of(Run, "actuator_lag"))
    for name, attribute in (("id", "agent_id"), *((each, each) for each in ("mass", "damping", "velocity"))):
        yield found({}, f"swarm.agents.0.{name}", setting_of(RobotConfig, attribute))
    for path, declaration in PARTS.items():
        yield from (found({}, *each) for each in settings(declaration, path))
    observer = {"observer": {"type": "parent_response"}}
    yield from (found(observer, *each) for each in settings(ParentResponse, "observer"))
    for trajectory in (Sine, Constant, QuinticStep):
        tree = {"controller": {"type": "arise", "trajectory": {"type": trajectory.type}}}
        yield from (found(tree, *each) for each in settings(trajectory, "controller.trajectory"))
    for name in CONTROLLERS.built_in:
        tree = {"controller": {"type": name}}
        for each in CONTROLLERS.find(name).settings:
            if not each.name.startswith("trajectory."):
                yield Place({**TREE, **tree}, f"controller.{each.name}", each, each, time=False)
    for kind, fault in FAULTS.items():
        required = {name[1:]: each.parameter.default for name, each in settings(fault, "") if each.required}
        tree = {"faults": [{"kind": kind, **required, **({"at": 1.0} if "at" in required else {})}]}
        yield from (found(tree, *each) for each in settings(fault, "faults.0"))


PLACES = {
    f"{each.path} of {each.tree.get('controller', each.tree.get('faults', ''))}"
    if each.tree != TREE
    else each.path: each
    for each in places()
}


def item(parameter: Parameter) -> Any:
    """Return the default, or what shows the type of a list's items."""
    default = parameter.default
    return (*default, parameter.item)[0] if isinstance(default, tuple) else default


def beside(parameter: Parameter, side: int) -> list[float]:
    """Return numbers next to each bound of a parameter: on the side that is refused (1), or taken (0)."""
    whole = isinstance(item(parameter), int)
    numbers: list[float] = []
    for bound, up in ((parameter.minimum, -1), (parameter.maximum, 1)):
        if bound is not None:
            beyond = bound + up if whole else math.nextafter(bound, up * math.inf)
            numbers.append(beyond if side else bound)
    for bound, up in ((parameter.above, 1), (parameter.below, -1)):
        if bound is not None:
            within = bound + up * (1 if whole else max(1e-9, abs(bound) * 1e-9))
            numbers.append(bound if side else within)
    return [int(number) if whole else number for number in numbers]


def filled(parameter: Parameter, number: Any) -> Any:
    """Return a value of a parameter of which the last number, if it has several, is this one."""
    default = parameter.default
    return [*default[:-1], number] if isinstance(default, tuple) else number


def changed(place: Place, value: Any) -> dict[str, Any]:
    tree = node = deepcopy(place.tree)
    *way, last = (int(part) if part.isdigit() else part for part in place.path.split("."))
    for part in way:
        node = node[part] if isinstance(node, list) else node.setdefault(part, {})
    node[last] = value
    return tree


def refusals(place: Place, value: Any) -> list[ScenarioError]:
    """Return how a value is refused in the file and in an override; nothing if it is taken."""
    override = f"{place.path}={value!r}"
    refused = []
    for tree, overrides in ((changed(place, value), ()), (place.tree, (override,))):
        try:
            parse_scenario(yaml.safe_dump(tree), source="f", overrides=overrides)
        except ScenarioError as error:
            refused.append(error)
    return refused


def assert_refused(place: Place, value: Any, problem: str) -> None:
    """The value is refused in file and override, by field and with this problem, and does not fit the schema."""
    refused, default = refusals(place, value), place.parameter.default
    index = f".{max(len(default), 1) - 1}" if isinstance(default, tuple) else ""
    assert [error.source for error in refused] == ["f", f"--set {place.path}={value!r}"]
    assert {error.field for error in refused} == {f"{place.path}{index}"}
    assert all(problem in error.problem and error.remedy for error in refused)
    assert not SCHEMA.is_valid(changed(place, value))


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_what_is_outside_of_the_bounds_is_refused_by_name(place: Place) -> None:
    for number in beside(place.in_file, 1):
        assert_refused(place, filled(place.parameter, number), f"{number!r} is out of range")
    for number in beside(place.parameter, 1):
        with pytest.raises(InputError, match=rf"parameter {place.parameter.name}: .* is not allowed; give (more|l|at)"):
            place.parameter.check(filled(place.parameter, number))
    kind, unbounded = type(item(place.in_file)), (place.in_file.maximum, place.in_file.below) == (None, None)
    if kind is int and unbounded:
        assert_refused(place, filled(place.parameter, 2**63), "is out of range")
    if kind is float:
        beyond = math.nextafter(LONGEST_TIME if place.time else LARGEST, math.inf)
        assert_refused(place, filled(place.parameter, beyond), "is out of range")
        if place.in_file.above == 0.0 and not place.time:
            refused = refusals(place, filled(place.parameter, SMALLEST / 2))
            assert [error.problem for error in refused] == [f"{SMALLEST / 2!r} is too small"] * 2


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_what_is_inside_of_the_bounds_is_taken(place: Place) -> None:
    for number in beside(place.in_file, 0):
        value = filled(place.parameter, number)
        # Another check may refuse it, which involves several settings.
        assert not [error for error in refusals(place, value) if re.search("out of range|expected", error.problem)]
        assert SCHEMA.is_valid(changed(place, value))
    for number in beside(place.parameter, 0):
        assert place.parameter.check(filled(place.parameter, number)) is not None


WRONG: dict[type, tuple[Any, ...]] = {bool: (1, "yes"), int: (1.5, True), float: (True, "0.5", [0.5]), str: (1, True)}


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_a_value_of_another_type_is_refused_by_name(place: Place) -> None:
    for wrong in WRONG[type(item(place.parameter))]:
        value = filled(place.parameter, wrong)
        assert_refused(place, value, "expected")
        with pytest.raises(InputError, match=rf"parameter {place.parameter.name}: .* is not allowed; give "):
            place.parameter.check(value)
