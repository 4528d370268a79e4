"""Declared parameters: name, default, meaning and bounds in one place.

The declaration to ROS, the checks and the documentation all use the same table of `Parameter`: one for each node and
each kind of parent controller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from swarmabs_core.errors import InputError

Scalar = bool | int | float | str
Value = Scalar | tuple[int, ...] | tuple[float, ...] | tuple[str, ...]
Settings = Mapping[str, Value]
"""Values by parameter name."""
_UNIT = "{unit}"


class SettingError(InputError):
    """Settings that contradict each other: the name of one, relative to the declaration, the problem and the remedy."""

    def __init__(self, name: str, problem: str, remedy: str) -> None:
        super().__init__(problem, remedy)
        self.name = name
        self.args = (name, problem, remedy)

    def __str__(self) -> str:
        return f"{self.name}: {super().__str__()}"


@dataclass(frozen=True, slots=True)
class Parameter:
    """A declared parameter, with the type of its default."""

    name: str  # dots separate levels
    default: Value
    description: str  # meaning; "{unit}" marks where the unit is read, by default at the end
    minimum: float | None = None  # inclusive bounds of a number, or of each number in an array
    maximum: float | None = None
    above: float | None = None  # exclusive bound, as `below`
    length: int | None = None  # required length of an array
    choices: tuple[str, ...] | None = None  # the strings allowed
    item: Scalar = ""  # determines the type of the items if the default is an empty array
    below: float | None = None
    unit: str = ""  # SI unit of a number, or of each number in an array; empty if it has none, or several

    @property
    def text(self) -> str:
        """Meaning and unit."""
        if self.unit and _UNIT not in self.description:
            return f"{self.description}, {self.unit}"
        return self.description.replace(_UNIT, self.unit)

    def check(self, value: Value) -> Value:
        """Return the value in the type of the default: arrays become tuples, and integers floats where required.

        Raises
        ------
        InputError
            If type, length, choice or bounds are violated; the text states parameter, value and what is allowed.
        """
        if isinstance(self.default, tuple):
            return self._check_array(value)
        return self._check_scalar(value, self.default)

    def _check_array(self, value: Value) -> Value:
        items = value if isinstance(value, (tuple, list)) else (value,)
        if self.length is not None and len(items) != self.length:
            raise self._refusal(value, f"{self.length} elements")
        model = self.default[0] if isinstance(self.default, tuple) and self.default else self.item
        return tuple(self._check_scalar(item, model) for item in items)  # type: ignore[return-value]

    def _check_scalar(self, value: Value, model: Scalar) -> Scalar:
        if isinstance(model, bool) or isinstance(value, bool):
            if isinstance(model, bool) and isinstance(value, bool):
                return value
            raise self._refusal(value, "true or false" if isinstance(model, bool) else "not a boolean")
        if isinstance(model, str):
            if not isinstance(value, str) or (self.choices is not None and value not in self.choices):
                raise self._refusal(value, "one of " + ", ".join(self.choices) if self.choices else "a text")
            return value
        if isinstance(value, int) and isinstance(model, float):
            value = float(value)
        if isinstance(value, (str, tuple)) or not isinstance(value, type(model)):
            raise self._refusal(value, f"a value of type {type(model).__name__}")
        self._check_bounds(value)
        return value

    def _check_bounds(self, value: float) -> None:
        if not isfinite(value):
            raise self._refusal(value, "a finite number")
        if self.above is not None and value <= self.above:
            raise self._refusal(value, f"more than {self.above:g}")
        if self.below is not None and value >= self.below:
            raise self._refusal(value, f"less than {self.below:g}")
        if self.minimum is not None and value < self.minimum:
            raise self._refusal(value, f"at least {self.minimum:g}")
        if self.maximum is not None and value > self.maximum:
            raise self._refusal(value, f"at most {self.maximum:g}")

    def _refusal(self, value: object, allowed: str) -> InputError:
        return InputError(f"parameter {self.name}: {value!r} is not allowed", f"give {allowed} ({self.text})")


def resolve(table: tuple[Parameter, ...], given: Settings, *, owner: str) -> dict[str, Value]:
    """Check given values against a table and fill in the defaults.

    Raises
    ------
    InputError
        If a value is not allowed, or a name is not in the table.
    """
    unknown = sorted(given.keys() - {parameter.name for parameter in table})
    if unknown:
        names = ", ".join(parameter.name for parameter in table)
        raise InputError(f"{owner} has no parameter {unknown[0]!r}", f"it has {names}")
    return {p.name: p.check(given[p.name]) if p.name in given else p.default for p in table}
