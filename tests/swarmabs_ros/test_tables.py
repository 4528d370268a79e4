"""The parameter tables of all nodes."""

from __future__ import annotations

import re

import pytest

from abstraction_observer import node as observer, realtime as realtime_observer
from agent_node import node as agent, realtime as realtime_agent
from parent_controller import node as controller, realtime as realtime_controller
from plane_sim import driver as plane_driver, node as plane, realtime as realtime_plane
from swarmabs_bag.recorder import node as recorder
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.drives import TOPIC
from swarmabs_ros.parameters import table_of
from swarmabs_ros.realtime_runner import COMMON as REALTIME_COMMON
from swarmabs_ros.runner import COMMON


def table(common: tuple[Parameter, ...], own: tuple[Parameter | type, ...]) -> tuple[Parameter, ...]:
    """Return a node's parameters without those that all nodes have."""
    return tuple(parameter for parameter in table_of({}, common, own) if parameter not in common)


TABLES = {
    "common": COMMON,
    "plane_sim": table(COMMON, plane.PARAMETERS),
    "topic drive": TOPIC.settings,
    "abstraction_observer": table(COMMON, observer.PARAMETERS),
    "parent_controller": table(COMMON, controller.PARAMETERS),
    "agent_node": table(COMMON, agent.PARAMETERS),
    "recorder": recorder.PARAMETERS,
    **{f"controller {name}": entry.settings for name, entry in CONTROLLERS.built_in.items()},
    "realtime common": REALTIME_COMMON,
    "realtime plane_sim": table(REALTIME_COMMON, realtime_plane.PARAMETERS),
    "realtime abstraction_observer": table(REALTIME_COMMON, realtime_observer.PARAMETERS),
    "realtime parent_controller": table(REALTIME_COMMON, realtime_controller.PARAMETERS),
    "realtime agent_node": table(REALTIME_COMMON, realtime_agent.PARAMETERS),
    "plane_driver": table(REALTIME_COMMON, plane_driver.PARAMETERS),
}
UNIT = re.compile(r"\b(ns|s|m|kg|rad|N|steps)\b|1/|0 to 1|probability|smoothing|gain|weight|friction", re.IGNORECASE)

tables = pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
parameters = pytest.mark.parametrize(
    "parameter", [pytest.param(p, id=f"{node}-{p.name}") for node, table in TABLES.items() for p in table]
)


@tables
def test_names_are_unique(table: tuple[Parameter, ...]) -> None:
    names = [parameter.name for parameter in table]
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("name", TABLES)
def test_no_node_redefines_a_common_parameter(name: str) -> None:
    common = REALTIME_COMMON if name.startswith("realtime") or name == "plane_driver" else COMMON
    if TABLES[name] is not common:
        assert not {p.name for p in TABLES[name]} & {p.name for p in common}


@parameters
def test_the_default_is_allowed(parameter: Parameter) -> None:
    assert parameter.check(parameter.default) == parameter.default


@parameters
def test_the_name_is_one_that_ros_takes(parameter: Parameter) -> None:
    assert re.fullmatch(r"[a-z][a-z0-9_]*(\.[a-z0-9_]+)*", parameter.name)


@parameters
def test_there_is_a_description_and_numbers_have_a_unit(parameter: Parameter) -> None:
    assert parameter.description
    model = parameter.default[0] if isinstance(parameter.default, tuple) and parameter.default else parameter.default
    if isinstance(model, float):
        assert UNIT.search(parameter.description), parameter.description


@parameters
def test_numbers_are_bounded_or_may_have_either_sign(parameter: Parameter) -> None:
    """A bound that is forgotten shows here: what has no bound is a coordinate, an amplitude or a gain."""
    model = parameter.default[0] if isinstance(parameter.default, tuple) and parameter.default else parameter.default
    bounds = (parameter.minimum, parameter.maximum, parameter.above, parameter.below)
    bounded = any(bound is not None for bound in bounds)
    either_sign = {
        *("position", "velocity", "angular_velocity", "gains", "controller.gains", "adaptive_initial"),
        *("amplitude", "angular_frequency", "disturbance.amplitude", "disturbance.angular_frequency"),
        *("offset", "imu.offset", "scale", "joint.scale"),
        *("trajectory.amplitude", "trajectory.angular_frequency", "trajectory.value", "trajectory.angle"),
    }
    if isinstance(model, (int, float)) and not isinstance(model, bool):
        assert bounded or parameter.name in either_sign
