"""Models derived from the declarations of core and from the settings of plug-ins.

Each setting is declared once, with default, bounds, unit and meaning. The strict model that checks a file, its schema
and its canonical text follow from the declaration.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, is_dataclass, replace
from functools import cache
from inspect import cleandoc
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, GetCoreSchemaHandler, JsonValue, create_model
from pydantic_core import CoreSchema, core_schema

from swarmabs_core.declaration import LONGEST_TIME, Part, Setting, attribute_of, entries_of, setting_of, tree_of
from swarmabs_core.parameters import Parameter, Scalar, SettingError

from .errors import show
from .fields import (
    LARGEST,
    TEXTS,
    Finding,
    Model,
    OrNumber,
    WholeNanoseconds,
    WithoutNegativeZero,
    as_error,
    as_tuple,
    not_tiny,
    problem,
)

_LARGEST_INTEGER = 2**63 - 1
_UNIT = "unit"
ModelT = TypeVar("ModelT", bound=Model)


@dataclass(frozen=True, eq=False)
class Declared:
    """Annotation of a field whose type is a declaration, which is validated by the model derived from it."""

    def __get_pydantic_core_schema__(self, source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by the derived model, and return an instance of the declaration."""
        model = handler.generate_schema(model_of(source))
        return core_schema.no_info_before_validator_function(
            lambda value: tree_of(value) if isinstance(value, source) else value,
            core_schema.no_info_after_validator_function(DeclaredModel.instance, model),
            serialization=core_schema.plain_serializer_function_ser_schema(tree_of),
        )


class DeclaredModel(Model):
    """Base of the models derived from declarations."""

    declaration: ClassVar[type]

    def instance(self) -> object:
        """Return an instance of the declaration."""
        return self._instance_of(self.declaration)

    def _instance_of(self, declaration: type) -> object:
        values: dict[str, object] = {}
        for name, attribute, declared in entries_of(declaration):
            if not name and isinstance(declared, Part):
                values[attribute] = self._instance_of(declared.declaration)
                continue
            value = getattr(self, _field_of(name))
            values[attribute] = attribute_of(declared, value) if isinstance(declared, Setting) else value
        try:
            return declaration(**values)
        except SettingError as error:
            location = tuple(error.name.split(".")) if error.name else ()
            raise as_error(Finding.of(location, error.problem, error.remedy)) from error


@cache
def model_of(declaration: type, tag: str = "") -> type[Model]:
    """Return the model of a declaration, documented by the first paragraph of the declaration's docstring.

    The `tag` is the key by which a file selects the declaration; its attribute of this name is the value of the key.
    """
    text = cleandoc(declaration.__doc__ or "").partition("\n\n")[0]
    fields: dict[str, Any] = {}
    if tag:
        name = getattr(declaration, tag)
        described = getattr(declaration, "description", f"{text[:1].lower()}{text[1:].rstrip('.')}")
        fields[tag] = (Literal[name], Field(default=name, description=described))
    fields |= _fields_of(declaration)
    model = create_model(declaration.__name__, __base__=DeclaredModel, __doc__=text, **fields)
    model.declaration = declaration
    return model


def _fields_of(declaration: type) -> dict[str, Any]:
    """Return the fields of a declaration's model by name, each with its type."""
    fields: dict[str, Any] = {}
    for name, _, declared in entries_of(declaration):
        if isinstance(declared, Part):
            inner = declared.declaration
            if name:
                annotation: Any = Annotated[inner, Declared()]
                fields[_field_of(name)] = (annotation, declared_field(inner, declared.description, alias=name))
            else:
                fields |= _fields_of(inner)
            continue
        assert isinstance(declared, Setting)  # noqa: S101 - a file cannot select anything else
        default = ... if declared.required else None if declared.unset is not None else declared.parameter.default
        content = described_field(declared.in_file, default=default, alias=name)
        fields[_field_of(name)] = (_type_of(declared), content)
    return fields


def described_field(declared: Parameter, **options: Any) -> Any:
    """Return a field with the meaning and the unit of a declared number or text."""
    return Field(description=declared.text, json_schema_extra=_with_unit(declared.unit), **options)


def measured(default: object, description: str, unit: str) -> Any:
    """Return a field that only files have, with its unit, for which ``{unit}`` stands in the description."""
    return described_field(Parameter("", "", description, unit=unit), default=default)


def _with_unit(unit: str) -> dict[str, JsonValue] | None:
    return {_UNIT: unit} if unit else None


def unit_at(content: object, path: str) -> str:
    """Return the unit of the number at a dotted path of a scenario; empty if it has none, several, or is missing."""
    unit = ""
    for name in path.split("."):
        if isinstance(content, Model):
            fields = {field.alias or key: (key, field) for key, field in type(content).model_fields.items()}
            if name not in fields:
                return ""
            key, field = fields[name]
            extra = field.json_schema_extra
            unit = str(extra.get(_UNIT, "")) if isinstance(extra, dict) else ""
            content = getattr(content, key)
        elif isinstance(content, tuple):
            content = content[int(name)] if name.isdigit() and int(name) < len(content) else None
        elif is_dataclass(content) and not isinstance(content, type):
            entry = next((entry for entry in entries_of(type(content)) if entry.name == name), None)
            if entry is None:
                return ""
            unit = entry.declared.parameter.unit if isinstance(entry.declared, Setting) else ""
            content = getattr(content, entry.attribute)
        else:
            return ""
    return unit


def declared_field(declaration: type, description: str, alias: str | None = None) -> Any:
    """Return a field whose type is a declaration; its default has all the declaration's defaults."""
    return Field(
        default_factory=declaration,
        alias=alias,
        description=description,
        json_schema_extra={"default": tree_of(declaration())},  # type: ignore[dict-item]  # plain data
    )


def model_of_table(
    title: str,
    base: type[ModelT],
    settings: Iterable[Parameter],
    last: Mapping[str, Any] = MappingProxyType({}),
    **fields: Any,
) -> type[ModelT]:
    """Return the model of a plug-in's settings, of further `fields` and of `last`; dotted names become mappings."""
    by_head: dict[str, list[Parameter]] = {}
    for setting in settings:
        head, _, rest = setting.name.partition(".")
        by_head.setdefault(head, []).append(replace(setting, name=rest))
    for head, group in by_head.items():
        if group[0].name:
            inner = model_of_table(f"{title}_{head}", Model, group)
            fields[_field_of(head)] = (
                inner,
                Field(default=inner(), alias=head, description=f"{head} settings of {title}"),
            )
        else:
            content = described_field(group[0], default=group[0].default, alias=head)
            fields[_field_of(head)] = (_of_parameter(group[0]), content)
    return create_model(title, __base__=base, **fields, **last)


def _field_of(name: str) -> str:
    """Return a field name that cannot collide with an attribute of pydantic's models."""
    return f"setting_{name}"


@dataclass(frozen=True, eq=False)
class Like:
    """Annotation of a field with the type and bounds of a declared setting."""

    declaration: type
    attribute: str

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by the declared type and bounds."""
        return handler.generate_schema(_type_of(setting_of(self.declaration, self.attribute)))


def like(declaration: type, attribute: str, *, required: bool = False) -> Any:
    """Return a field, annotated with `Like`, with the default and description of the declared setting."""
    declared = setting_of(declaration, attribute)
    return described_field(declared.in_file, default=... if required else declared.parameter.default)


def _type_of(declared: Setting) -> Any:
    """Return the type of a setting in a file."""
    annotation = _of_parameter(declared.in_file, whole_nanoseconds=declared.whole_nanoseconds, names=declared.names)
    return annotation if declared.unset is None else annotation | None


def _of_parameter(setting: Parameter, **more: Any) -> Any:
    """Return the type of a setting with its bounds."""
    default, length = setting.default, setting.length
    if not isinstance(default, tuple):
        return _scalar(setting, default, **more)
    item = _scalar(setting, default[0] if default else setting.item, **more)
    array: Any = tuple  # mypy cannot follow types that are made at run time
    annotated: Any = Annotated
    if length is not None:
        return annotated[array[(item,) * length], BeforeValidator(as_tuple(length))]
    if not default:
        return annotated[array[item, ...], BeforeValidator(as_tuple(None))]
    # An empty ROS parameter counts as not given, so the node would use its default.
    values = annotated[array[item, ...], AfterValidator(_not_empty), BeforeValidator(as_tuple(None))]
    return annotated[values, OrNumber()] if len(default) == 1 and isinstance(default[0], float) else values


def _scalar(
    setting: Parameter,
    model: Scalar,
    *,
    names: str = "",
    whole_nanoseconds: bool = False,
) -> Any:
    low, high, above, below = map(_whole, (setting.minimum, setting.maximum, setting.above, setting.below))
    if isinstance(model, bool):
        return bool
    if isinstance(model, str):
        if setting.choices:
            return Literal[setting.choices]
        return TEXTS[names] if names else Annotated[str, AfterValidator(_printable)]
    if isinstance(model, int):
        most = None if below is not None else _LARGEST_INTEGER if high is None else high
        return Annotated[int, Field(gt=above, ge=-_LARGEST_INTEGER if low is None else low, lt=below, le=most)]
    if whole_nanoseconds:
        return Annotated[float, Field(gt=above, ge=low, le=LONGEST_TIME if high is None else high), WholeNanoseconds]
    least = None if above is not None else -LARGEST if low is None else low
    most = None if below is not None else LARGEST if high is None else high
    bounds = Field(gt=above, ge=least, lt=below, le=most)
    return Annotated[float, bounds, AfterValidator(not_tiny) if above == 0.0 else WithoutNegativeZero]


def _whole(bound: float | None) -> float | None:
    """Return a whole bound as an integer, as schemas and errors show it."""
    return int(bound) if bound is not None and bound == int(bound) else bound


def _not_empty(values: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    if not values:
        raise problem("expected a list of at least one value, found an empty one", "remove the key to use its default")
    return values


def _printable(text: str) -> str:
    if not text.isprintable():
        raise problem(f"{show(text)} contains unprintable characters", "give one line of printable text")
    return text
