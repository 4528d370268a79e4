"""Declarations: frozen dataclasses whose fields state default, bounds, unit and meaning in one place.

A field is a `setting`, a `part` (a nested declaration), or a `choice` among the parts of a registry. `parameters_of`
derives the parameters of a node from a declaration, `values_of` their values from an instance, and `made_of` an
instance from values. The schemas of files and the tables of the documentation are derived from declarations, too.

`inf` and None mean "none": a file then contains null, and a parameter its value `unset`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypedDict, TypeVar, cast

from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter, Scalar, SettingError, Settings, Value

if TYPE_CHECKING:
    from typing_extensions import Unpack

_KEY = "declared"
_ORIGIN = "same"
LONGEST_TIME = 2**31 - 1
"""Longest time, s: the range of the seconds of a ROS time stamp."""
DeclarationT = TypeVar("DeclarationT")
DefaultT = TypeVar("DefaultT")


class Bounds(TypedDict, total=False):
    """What a `Parameter` says of its values; the meaning is there."""

    unit: str
    minimum: float | None
    maximum: float | None
    above: float | None
    below: float | None
    length: int | None
    choices: tuple[str, ...] | None
    item: Scalar


@dataclasses.dataclass(frozen=True, slots=True)
class Setting:
    """The declaration of one setting: as a parameter of a node, in a file (both without a name), and in the object.

    `unset` is the parameter's value for none; it is None if there is no such value. `make` converts the value of the
    parameter, or of an item of an array, to that of the attribute; `say` is the inverse.
    """

    parameter: Parameter
    in_file: Parameter
    default: object
    unset: Value | None
    make: Callable[..., object] | None
    say: Callable[..., Value]
    whole_nanoseconds: bool
    names: str
    required: bool


@dataclasses.dataclass(frozen=True, slots=True)
class Part:
    """A declaration nested in another one, except for some of its settings."""

    declaration: type
    description: str
    without: tuple[str, ...]


class Selected(Protocol):
    """A part that is selected by its name, such as one of a registry."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def settings(self) -> tuple[Parameter, ...]:
        """The settings that it declares."""
        ...


@dataclasses.dataclass(frozen=True, slots=True)
class Choice:
    """A part of the system that is selected by its name, ``type``, with the settings that it declares."""

    find: Callable[[str], Selected]
    built_in: tuple[str, ...]
    default: str
    description: str


class Entry(NamedTuple):
    """A field of a declaration: its name in files and parameters, its attribute, and what it declares."""

    name: str
    attribute: str
    declared: Setting | Part | Choice


def setting(
    default: DefaultT,
    description: str,
    *,
    name: str | None = None,
    unset: Value | None = None,
    null: str = "none",
    make: Callable[..., object] | None = None,
    say: Callable[..., Value] = str,
    whole_nanoseconds: bool = False,
    names: str = "",
    required: bool = False,
    **bounds: Unpack[Bounds],
) -> DefaultT:
    """Declare a field of a dataclass.

    Parameters
    ----------
    default : object
        Default, which determines the type; `inf` and None require `unset`.
    description : str
        Meaning, in which ``{unit}`` stands for the unit; without it, the unit follows at the end.
    name : str, optional
        Name as a parameter and in files, if it differs from the attribute.
    unset, make, say
        As in `Setting`.
    null : str
        Meaning of null in a file.
    whole_nanoseconds : bool
        Whether it is a time in s that must be a whole number of ns.
    names : str
        What a string names: ``name`` (a host), ``topic`` or ``frame``; empty for any string.
    required : bool
        Whether a file must contain it.
    bounds : object
        As in `Parameter`: unit, minimum, maximum, above, below, length, choices, item.
    """
    stated = cast("Value", default)
    if unset is not None:
        stated = unset
    elif make is not None and not isinstance(default, tuple):
        stated = say(default)
    unit = bounds.get("unit", "")
    if unit and "{unit}" not in description:
        description = f"{description}, {{unit}}"  # before what is added below
    parameter = Parameter("", stated, description, **bounds)
    in_file = parameter
    if unset is not None:
        in_file = dataclasses.replace(parameter, description=f"{description}; null: {null}")
    if isinstance(unset, (int, float)):
        parameter = dataclasses.replace(
            parameter, description=f"{description}; {unset:g}: none", minimum=unset, above=None
        )
    declared = Setting(parameter, in_file, default, unset, make, say, whole_nanoseconds, names, required)
    return dataclasses.field(default=default, metadata={_KEY: (name, declared)})


def part(
    declaration: type[DeclarationT], description: str = "", *, name: str | None = None, without: tuple[str, ...] = ()
) -> DeclarationT:
    """Declare a field that is a nested declaration, with its defaults.

    With an empty `name`, its settings are named without a prefix. The attributes listed in `without` keep their
    defaults and are not settings here.
    """
    return dataclasses.field(
        default_factory=declaration, metadata={_KEY: (name, Part(declaration, description, without))}
    )


def choice(find: Callable[[str], Selected], built_in: Mapping[str, object], default: str, description: str) -> str:
    """Declare a field that names a part, which `find` looks up; the field ``..._settings`` contains its settings."""
    return dataclasses.field(
        default=default, metadata={_KEY: (None, Choice(find, tuple(built_in), default, description))}
    )


def same(declaration: type, attribute: str, *, name: str | None = None) -> Any:
    """Declare a field like a field of another declaration, possibly under another name."""
    declared = setting_of(declaration, attribute)
    metadata = {_KEY: (name, declared), _ORIGIN: (declaration, attribute)}
    return dataclasses.field(default=declared.default, metadata=metadata)


def gathered(declaration: type[DeclarationT], *sources: object, **own: object) -> DeclarationT:
    """Return an instance of a declaration that takes its parts, and its fields declared by `same`, from sources.

    Sources are instances of other declarations, at most one of each. Fields without a source have their defaults.
    """
    by_type = {type(source): source for source in sources}
    for field in dataclasses.fields(declaration):  # type: ignore[arg-type]  # it is a dataclass
        declared = field.metadata.get(_KEY, (None, None))[1]
        origin, attribute = field.metadata.get(_ORIGIN, (None, ""))
        if field.name in own:
            continue
        if isinstance(declared, Part) and declared.declaration in by_type:
            own[field.name] = by_type[declared.declaration]
        elif origin in by_type:
            own[field.name] = getattr(by_type[origin], attribute)
    return declaration(**own)


def setting_of(declaration: type, attribute: str) -> Setting:
    """Return the setting that a declaration declares for an attribute."""
    entry = next(entry for entry in entries_of(declaration) if entry.attribute == attribute)
    if not isinstance(entry.declared, Setting):
        raise TypeError(f"{declaration.__name__}.{attribute} is not a setting")
    return entry.declared


def attribute_of(declared: Setting, value: Value | None) -> object:
    """Return the value of an attribute for its value in a file, None for none; `tree_of` contains the inverse."""
    return declared.default if value is None else _made(declared, value)


def entries_of(declaration: type) -> tuple[Entry, ...]:
    """Return the declared fields of a dataclass, in order; other fields are left out."""
    entries = []
    for field in dataclasses.fields(declaration):
        if _KEY in field.metadata:
            name, declared = field.metadata[_KEY]
            entries.append(Entry(field.name if name is None else name, field.name, declared))
    return tuple(entries)


def parameters_of(
    declaration: type, given: Mapping[str, object] | None = None, prefix: str = ""
) -> tuple[Parameter, ...]:
    """Return the parameters of a declaration.

    The values `given`, by name, select the parts; without them, only the choices are returned, not the settings of the
    selected parts.

    Raises
    ------
    InputError
        If there is no part of the selected name, or the package that provides it is unusable.
    """
    parameters: list[Parameter] = []
    for name, attribute, declared in entries_of(declaration):
        if isinstance(declared, Part):
            inner = parameters_of(declared.declaration, given, _below(prefix, name))
            left_out = {_below(prefix, name) + attribute for attribute in declared.without}
            parameters += [parameter for parameter in inner if parameter.name not in left_out]
        elif isinstance(declared, Setting):
            parameters.append(dataclasses.replace(declared.parameter, name=prefix + name))
        else:
            parameters += _chosen(declared, f"{prefix}{attribute}.", given)
    return tuple(parameters)


def values_of(instance: object, prefix: str = "") -> dict[str, Value]:
    """Return the values of a declaration's parameters by name; `made_of` is the inverse."""
    values: dict[str, Value] = {}
    for name, attribute, declared in entries_of(type(instance)):
        value = getattr(instance, attribute)
        if isinstance(declared, Part):
            inner = values_of(value, _below(prefix, name))
            values |= {
                key: inner[key] for key in inner if key not in {_below(prefix, name) + w for w in declared.without}
            }
        elif isinstance(declared, Setting):
            values[prefix + name] = _said(declared, value)
        else:
            settings: Settings = getattr(instance, f"{attribute}_settings")
            values[f"{prefix}{attribute}.type"] = value
            values |= {f"{prefix}{attribute}.{key}": settings[key] for key in settings}
    return values


def made_of(declaration: type[DeclarationT], values: Settings, prefix: str = "", **others: object) -> DeclarationT:
    """Return the instance of a declaration whose parameters have these checked values.

    Every parameter needs a value, under its name with the prefix; `others` are the fields that are not declared.

    Raises
    ------
    SettingError
        If the values contradict each other.
    """
    for name, attribute, declared in entries_of(declaration):
        if isinstance(declared, Part):
            below = _below(prefix, name)
            kept = values_of(declared.declaration(), below)
            others[attribute] = made_of(declared.declaration, {**kept, **values}, below)
        elif isinstance(declared, Setting):
            others[attribute] = _meant(declared, values[prefix + name])
        else:
            start = f"{prefix}{attribute}."
            settings = {key[len(start) :]: value for key, value in values.items() if key.startswith(start)}
            others[attribute] = settings.pop("type")
            others[f"{attribute}_settings"] = settings
    try:
        return declaration(**others)
    except SettingError as error:
        raise SettingError(prefix + error.name, error.problem, error.remedy) from error


def tree_of(instance: object) -> dict[str, object]:
    """Return an instance of a declaration as in a file: nested mappings, with None for none."""
    tree: dict[str, object] = {}
    for name, attribute, declared in entries_of(type(instance)):
        value = getattr(instance, attribute)
        if isinstance(declared, Part):
            tree |= {name: tree_of(value)} if name else tree_of(value)
        elif isinstance(declared, Setting):
            unset = declared.unset is not None and value == declared.default
            tree[name] = None if unset else _said(declared, value)
    return tree


def _below(prefix: str, name: str) -> str:
    return f"{prefix}{name}." if name else prefix


def _chosen(declared: Choice, prefix: str, given: Mapping[str, object] | None) -> Iterator[Parameter]:
    """Yield the parameter that selects a part, and the settings of the selected part."""
    chooser = Parameter(f"{prefix}type", declared.default, declared.description, choices=declared.built_in)
    if given is None:
        yield chooser
        return
    try:
        chosen = declared.find(str(given.get(chooser.name, declared.default)))
    except InputError as error:
        raise InputError(f"parameter {chooser.name}: {error.problem}", error.remedy) from error
    yield dataclasses.replace(chooser, choices=tuple(dict.fromkeys((*declared.built_in, chosen.name))))
    for parameter in chosen.settings:
        yield dataclasses.replace(parameter, name=prefix + parameter.name)


def _said(declared: Setting, value: object) -> Value:
    """Return the value of a parameter for that of the attribute."""
    if declared.unset is not None and value == declared.default:
        return declared.unset
    if isinstance(value, tuple):
        plain = declared.make is None or declared.parameter.length
        return cast("Value", tuple(value) if plain else tuple(map(declared.say, value)))
    return cast("Value", value) if declared.make is None else declared.say(value)


def _meant(declared: Setting, value: Value) -> object:
    """Return the value of the attribute for that of a parameter."""
    if declared.unset is not None and value == declared.unset:
        return declared.default
    return _made(declared, value)


def _made(declared: Setting, value: Value) -> object:
    if declared.make is None:
        return value
    if isinstance(value, tuple) and not declared.parameter.length:
        return tuple(map(declared.make, value))
    return declared.make(value)
