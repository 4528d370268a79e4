"""Parameters: those of a real node are declared, described, checked, read-only; those of all nodes are of one style."""

import importlib
import re

import pytest
from rclpy.parameter import Parameter as RosParameter
from tests.swarmabs_ros.nodes import given, started_node

from swarmabs_config.graph import LOCKSTEP, NODES, REALTIME, Driver
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter, Value
from swarmabs_core.realtime.drives import TOPIC
from swarmabs_ros.parameters import declare, table_of
from swarmabs_ros.realtime_runner import COMMON as REALTIME_COMMON
from swarmabs_ros.runner import COMMON

with_ros = pytest.mark.usefixtures("ros")

TABLE = (
    Parameter("mass", 0.5, "mass, kg", above=0.0, below=9.0),
    Parameter("angle", 0.1, "angle, rad", minimum=-1.5, maximum=1.5),
    Parameter("count", 3, "a number of things", minimum=1, maximum=65535),
    Parameter("seed", 5, "a number without an end", minimum=0),
    Parameter("kind", "square", "a kind", choices=("square", "round")),
    Parameter("loud", default=False, description="whether to shout"),
    Parameter("gains", (1.0, 2.0), "two gains, 1/s", above=0.0, length=2),
    Parameter("ids", (1, 2), "ids", minimum=1, maximum=9),
    Parameter("texts", (), "texts"),
)
DEFAULTS = {parameter.name: parameter.default for parameter in TABLE}


@with_ros
@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("use_sim_time", "false", None),
        ("mass", "2", 2.0),
        ("mass", "1e-05", 1e-05),
        ("angle", "1", 1.0),
        ("kind", "'round'", "round"),
        ("loud", "true", True),
        ("gains", "[3, 4]", (3.0, 4.0)),
        ("ids", "[9]", (9,)),
        ("texts", "['kill 3 500', 'a: b']", ("kill 3 500", "a: b")),
    ],
)
def test_a_value_is_taken_as_the_type_that_is_due(name: str, text: str, value: Value | None) -> None:
    with started_node(*given(**{name: text})) as node:
        values = declare(node, TABLE)
    assert repr(values) == repr(DEFAULTS if value is None else DEFAULTS | {name: value})


@with_ros
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("masss", "0.75"),
        *(("mass", text) for text in ("-1", "heavy", "[1.0]")),
        *(("count", "2.5"), ("kind", "3"), ("loud", "1")),
        *(("gains", "[1.0]"), ("gains", "[a, b]"), ("texts", "[1, 2]")),
    ],
)
def test_a_wrong_value_is_refused_in_one_line_that_names_it(name: str, text: str) -> None:
    with started_node(*given(**{name: text})) as node, pytest.raises(InputError) as refusal:
        declare(node, TABLE)
    message = str(refusal.value)
    assert message.startswith(f"parameter {name}: ") and "\n" not in message
    unknown = "probe has no parameter of this name; did you mean mass?"
    assert next((parameter.description for parameter in TABLE if parameter.name == name), unknown) in message


@with_ros
def test_parameters_have_defaults_describe_themselves_and_cannot_be_changed_later() -> None:
    with started_node() as node:
        assert declare(node, TABLE) == DEFAULTS
        for parameter in TABLE:
            descriptor = node.describe_parameter(parameter.name)
            assert descriptor.description == parameter.description
            assert descriptor.read_only
        (result,) = node.set_parameters([RosParameter("mass", value=2.0)])
        assert not result.successful
        assert node.get_parameter("mass").value == DEFAULTS["mass"]
        mass, angle, count, kind, gains = (
            node.describe_parameter(name) for name in ("mass", "angle", "count", "kind", "gains")
        )
    assert mass.additional_constraints == "more than 0; less than 9"
    assert kind.additional_constraints == "one of square, round"
    assert gains.additional_constraints == "more than 0; 2 elements"
    ranges = [*angle.floating_point_range, *count.integer_range]
    assert [(bounds.from_value, bounds.to_value) for bounds in ranges] == [(-1.5, 1.5), (1, 65535)]


COMMONS = {LOCKSTEP: COMMON, REALTIME: REALTIME_COMMON}


def own(name: str, driver: Driver) -> tuple[Parameter, ...]:
    """Return a node's parameters without those that all nodes have."""
    table = importlib.import_module(NODES[name].modules[driver]).PARAMETERS
    return tuple(parameter for parameter in table_of({}, (), table) if parameter not in COMMONS[driver])


TABLES = {
    **{f"{driver.value} common": common for driver, common in COMMONS.items()},
    **{f"{driver.value} {name}": own(name, driver) for name, node in NODES.items() for driver in node.modules},
    **{f"controller {name}": entry.settings for name, entry in CONTROLLERS.built_in.items()},
    "topic drive": TOPIC.settings,
}
UNIT = re.compile(r"\b(ns|s|m|kg|rad|N|steps)\b|1/|0 to 1|probability|smoothing|gain|weight|friction", re.IGNORECASE)

EITHER_SIGN = {
    *("position", "velocity", "angular_velocity", "gains", "controller.gains", "adaptive_initial"),
    *("amplitude", "angular_frequency", "disturbance.amplitude", "disturbance.angular_frequency"),
    *("offset", "imu.offset", "scale", "joint.scale", "center_height", "plane.moment"),
    *("trajectory.amplitude", "trajectory.angular_frequency", "trajectory.value", "trajectory.angle"),
}
"""Coordinates, heights, amplitudes and gains: all other numbers have a bound."""


@pytest.mark.parametrize("name", TABLES)
def test_names_are_unique_not_common_ones_and_have_defaults_units_and_bounds(name: str) -> None:
    names = [parameter.name for parameter in TABLES[name]]
    assert len(set(names)) == len(names)
    common = REALTIME_COMMON if name.startswith("realtime") else COMMON
    if TABLES[name] is not common:
        assert not set(names) & {parameter.name for parameter in common}
    for parameter in TABLES[name]:
        assert re.fullmatch(r"[a-z][a-z0-9_]*(\.[a-z0-9_]+)*", parameter.name), "a name that ROS takes"
        assert parameter.check(parameter.default) == parameter.default
        assert parameter.text and "{" not in parameter.text
        default = parameter.default
        model = default[0] if isinstance(default, tuple) and default else default
        if isinstance(model, float):
            assert UNIT.search(parameter.text), parameter
        if isinstance(model, (int, float)) and not isinstance(model, bool):
            bounds = (parameter.minimum, parameter.maximum, parameter.above, parameter.below)
            assert any(bound is not None for bound in bounds) or parameter.name in EITHER_SIGN, parameter
