"""Declaration of a node's parameters to ROS from its table."""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter as RosParameter

from swarmabs_core.declaration import parameters_of
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rclpy.node import Node

    from swarmabs_core.parameters import Parameter, Value


ConfigT_co = TypeVar("ConfigT_co", covariant=True)

SIM_TIME = "use_sim_time"
NO_SIM_TIME = f"parameter {SIM_TIME}: no ROS clock determines the steps of a swarm; omit it"
_OF_RCLPY = (SIM_TIME, "start_type_description_service", "qos_overrides.")
"""Parameters that every node of rclpy may have."""


@dataclass(frozen=True, slots=True)
class BySystem(Generic[ConfigT_co]):
    """The declaration of a node's parameters on the plane, and on the parent system that ``system.type`` names."""

    plane: type[ConfigT_co]
    system: type[ConfigT_co]

    def chosen(self, given: Mapping[str, object]) -> type[ConfigT_co]:
        """Return the declaration that given values select."""
        return self.system if "system.type" in given else self.plane


Table: TypeAlias = tuple["type | BySystem[object]", ...]
"""The declarations from which the parameters of a node follow."""


def given_values(node: Node) -> dict[str, object]:
    """Return the parameter values that a node was given and has declared automatically, by name."""
    return {name: node.get_parameter(name).value for name in node.get_parameters_by_prefix("")}


def table_of(given: Mapping[str, object], common: tuple[Parameter, ...], own: Table) -> tuple[Parameter, ...]:
    """Return the parameters of a node: those common to all nodes, and those of its own declarations.

    Given values may select parts that add parameters. Raises `InputError` if there is no such part.
    """
    by_name = {parameter.name: parameter for parameter in common}
    for declared in own:
        declaration = declared.chosen(given) if isinstance(declared, BySystem) else declared
        for parameter in parameters_of(declaration, given):
            by_name.setdefault(parameter.name, parameter)
    return tuple(by_name.values())


def read(node: Node, common: tuple[Parameter, ...], own: Table) -> tuple[tuple[Parameter, ...], dict[str, Value]]:
    """Return the parameters of a node of a swarm, as from `table_of`, and their values, as from `checked`.

    Raises `InputError` as these do, and if the node is told to follow a ROS clock.
    """
    if node.get_parameter(SIM_TIME).value:
        raise InputError(NO_SIM_TIME)
    table = table_of(given_values(node), common, own)
    return table, checked(node, table)


def declare(node: Node, table: tuple[Parameter, ...]) -> dict[str, Value]:
    """Declare all parameters of a node as read-only, and return their values from `checked`."""
    values = checked(node, table)
    declare_values(node, table, values)
    return values


def checked(node: Node, table: tuple[Parameter, ...]) -> dict[str, Value]:
    """Return the values of a node's parameters: those given, and otherwise the defaults.

    Raises `InputError` if a value is not allowed, or there is no such parameter.
    """
    given = given_values(node)
    names = {parameter.name for parameter in table}
    for name in sorted(given):
        if name not in names and not name.startswith(_OF_RCLPY):
            close = difflib.get_close_matches(name, names, n=1)
            hint = f"did you mean {close[0]}?" if close else f"its parameters are {', '.join(sorted(names))}"
            raise InputError(f"parameter {name}: {node.get_name()} has no parameter of this name; {hint}")
    return {p.name: p.check(plain(given[p.name])) if p.name in given else p.default for p in table}


def declare_values(
    node: Node, table: tuple[Parameter, ...], values: Mapping[str, Value], settable: tuple[Parameter, ...] = ()
) -> None:
    """Declare parameters with these values and their descriptions, read-only unless they are settable.

    Given parameters, which the node has declared automatically, are declared again.
    """
    for parameter in table:
        if node.has_parameter(parameter.name):
            node.undeclare_parameter(parameter.name)
        value = values[parameter.name]
        listed = list(value) if isinstance(value, tuple) else value
        # An empty list does not show its type.
        model = RosParameter.Type.from_parameter_value([parameter.item]) if listed == [] else listed
        descriptor = _descriptor(parameter, read_only=parameter not in settable)
        node.declare_parameter(parameter.name, model, descriptor, ignore_override=True)


def plain(value: object) -> Value:
    """Convert the value of a ROS parameter to that of a `Parameter`: arrays become tuples."""
    if isinstance(value, (bool, int, float, str)):
        return value
    return tuple(value)  # type: ignore[arg-type]  # lists and arrays of numbers or strings


def _descriptor(parameter: Parameter, *, read_only: bool) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(name=parameter.name, description=parameter.text, read_only=read_only)
    constraints = []
    if parameter.above is not None:
        constraints.append(f"more than {parameter.above:g}")
    if parameter.below is not None:
        constraints.append(f"less than {parameter.below:g}")
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
