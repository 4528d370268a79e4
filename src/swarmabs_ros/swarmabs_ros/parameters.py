"""Declaration of a node's parameters to ROS, from the node's table."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.parameter import Parameter as RosParameter

from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from rclpy.node import Node

    from swarmabs_core.parameters import Parameter, Value


def declare(node: Node, table: tuple[Parameter, ...]) -> dict[str, Value]:
    """Declare parameters, read-only, and return their checked values; those declared before are only checked.

    Raises
    ------
    InputError
        If a value that was given is refused.
    """
    values: dict[str, Value] = {}
    for parameter in table:
        given = _declare(node, parameter)
        values[parameter.name] = parameter.check(_plain(given) if given is not None else parameter.default)
    return values


def _declare(node: Node, parameter: Parameter) -> object:
    if node.has_parameter(parameter.name):
        return node.get_parameter(parameter.name).value
    default = list(parameter.default) if isinstance(parameter.default, tuple) else parameter.default
    # The type of an empty list cannot be seen: such parameters are arrays of texts.
    model = RosParameter.Type.STRING_ARRAY if default == [] else default
    try:
        return node.declare_parameter(parameter.name, model, _descriptor(parameter)).value
    except ParameterException as error:
        raise InputError(f"parameter {parameter.name}: {error} ({parameter.description})") from error


def _plain(value: object) -> Value:
    if isinstance(value, (bool, int, float, str)):
        return value
    return tuple(value)  # type: ignore[arg-type]  # lists and arrays of numbers or texts


def _descriptor(parameter: Parameter) -> ParameterDescriptor:
    # Dynamic typing lets an integer stand for a number; `Parameter.check` refuses every other type.
    # An array of texts without default has no value to stand in for, and rclpy then wants the type fixed.
    descriptor = ParameterDescriptor(
        name=parameter.name,
        description=parameter.description,
        read_only=True,
        dynamic_typing=parameter.default != (),
    )
    constraints = []
    if parameter.above is not None:
        constraints.append(f"more than {parameter.above:g}")
    if parameter.length is not None:
        constraints.append(f"{parameter.length} elements")
    if parameter.choices is not None:
        constraints.append("one of " + ", ".join(parameter.choices))
    descriptor.additional_constraints = "; ".join(constraints)
    low, high = parameter.minimum, parameter.maximum
    if isinstance(parameter.default, float) and (low is not None or high is not None):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=-1.7e308 if low is None else low, to_value=1.7e308 if high is None else high)
        ]
    elif type(parameter.default) is int and (low is not None or high is not None):
        descriptor.integer_range = [
            IntegerRange(
                from_value=-(2**63) if low is None else int(low), to_value=2**63 - 1 if high is None else int(high)
            )
        ]
    return descriptor
