"""Parameters of a real node: declared, described, checked, read-only."""

from __future__ import annotations

import pytest
from rclpy.parameter import Parameter as RosParameter
from tests.swarmabs_ros.nodes import given, started_node

from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter, Value
from swarmabs_ros.parameters import declare

pytestmark = pytest.mark.usefixtures("ros")

TABLE = (
    Parameter("mass", 0.5, "mass, kg", above=0.0),
    Parameter("angle", 0.1, "angle, rad", minimum=-1.5, maximum=1.5),
    Parameter("count", 3, "a number of things", minimum=1, maximum=65535),
    Parameter("kind", "square", "a kind", choices=("square", "round")),
    Parameter("loud", default=False, description="whether to shout"),
    Parameter("gains", (1.0, 2.0), "two gains, 1/s", above=0.0, length=2),
    Parameter("ids", (1, 2), "ids", minimum=1, maximum=9),
    Parameter("texts", (), "texts"),
)
DEFAULTS = {parameter.name: parameter.default for parameter in TABLE}


def values_of(*arguments: str) -> dict[str, Value]:
    with started_node(*arguments) as node:
        return declare(node, TABLE)


def test_defaults_are_the_tables() -> None:
    assert values_of() == DEFAULTS


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("mass", "0.25", 0.25),
        ("mass", "2", 2.0),
        ("mass", "1e-05", 1e-05),
        ("angle", "-1.5", -1.5),
        ("angle", "1", 1.0),
        ("count", "65535", 65535),
        ("kind", "round", "round"),
        ("kind", "'round'", "round"),
        ("loud", "true", True),
        ("gains", "[3.0, 4.5]", (3.0, 4.5)),
        ("gains", "[3, 4]", (3.0, 4.0)),
        ("ids", "[9]", (9,)),
        ("texts", "['kill 3 500', 'a: b']", ("kill 3 500", "a: b")),
    ],
)
def test_a_value_is_taken_as_the_type_that_is_due(name: str, text: str, value: Value) -> None:
    found = values_of(*given(**{name: text}))
    assert found == DEFAULTS | {name: value}
    assert type(found[name]) is type(value)
    if isinstance(value, tuple):
        assert [type(item) for item in found[name]] == [type(item) for item in value]  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("mass", "0.0"),
        ("mass", "-1"),
        ("mass", ".nan"),
        ("mass", ".inf"),
        ("mass", "heavy"),
        ("mass", "true"),
        ("mass", "[1.0]"),
        ("angle", "1.6"),
        ("angle", "-2"),
        ("angle", ".nan"),
        ("count", "0"),
        ("count", "65536"),
        ("count", "2.5"),
        ("kind", "oval"),
        ("kind", "3"),
        ("loud", "1"),
        ("loud", "maybe"),
        ("gains", "[1.0]"),
        ("gains", "[1.0, 2.0, 3.0]"),
        ("gains", "[1.0, -2.0]"),
        ("gains", "[a, b]"),
        ("ids", "[0]"),
        ("ids", "[1.5]"),
        ("texts", "[1, 2]"),
    ],
)
def test_a_wrong_value_is_refused_in_one_line_that_names_it(name: str, text: str) -> None:
    with started_node(*given(**{name: text})) as node, pytest.raises(InputError) as refusal:
        declare(node, TABLE)
    message = str(refusal.value)
    assert message.startswith(f"parameter {name}: ")
    assert "\n" not in message
    description = next(parameter.description for parameter in TABLE if parameter.name == name)
    assert description in message


def test_parameters_describe_themselves() -> None:
    with started_node() as node:
        declare(node, TABLE)
        for parameter in TABLE:
            descriptor = node.describe_parameter(parameter.name)
            assert descriptor.description == parameter.description
            assert descriptor.read_only
        mass, angle, count, kind, gains = (
            node.describe_parameter(name) for name in ("mass", "angle", "count", "kind", "gains")
        )
    assert mass.additional_constraints == "more than 0"
    assert kind.additional_constraints == "one of square, round"
    assert gains.additional_constraints == "more than 0; 2 elements"
    (bounds,) = angle.floating_point_range
    assert (bounds.from_value, bounds.to_value) == (-1.5, 1.5)
    (integers,) = count.integer_range
    assert (integers.from_value, integers.to_value) == (1, 65535)


@pytest.mark.parametrize(("name", "value"), [("mass", 2.0), ("count", 4), ("kind", "round"), ("gains", [5.0, 6.0])])
def test_nothing_can_be_changed_later(name: str, value: object) -> None:
    with started_node() as node:
        declare(node, TABLE)
        before = node.get_parameter(name).value
        (result,) = node.set_parameters([RosParameter(name, value=value)])
        assert not result.successful
        assert node.get_parameter(name).value == before


def test_a_name_that_is_not_in_the_table_is_refused_with_the_nearest() -> None:
    with (
        started_node(*given(masss="0.75")) as node,
        pytest.raises(InputError, match=r"^parameter masss: probe has none of this name; did you mean mass\?$"),
    ):
        declare(node, TABLE)


def test_what_every_node_may_be_given_is_no_unknown_name() -> None:
    with started_node(*given(use_sim_time="false")) as node:
        assert declare(node, TABLE) == DEFAULTS
