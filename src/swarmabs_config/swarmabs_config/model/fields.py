"""Building blocks of the models of files: the strict base model, numbers, times, texts, lists and tagged choices."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from difflib import get_close_matches
from fractions import Fraction
from typing import Annotated, TypeAlias

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from swarmabs_core.cdr import SECOND
from swarmabs_core.declaration import LONGEST_TIME, tree_of
from swarmabs_core.registry import PluginError

from .errors import describe, shorten, show

Location: TypeAlias = tuple[str | int, ...]

LARGEST = 1e12
"""Largest magnitude of any number: far above any physical value, low enough that no sum or square overflows."""
SMALLEST = 1e-12
"""Smallest magnitude of a number that must be positive."""


def problem(text: str, remedy: str, see: Location | None = None) -> PydanticCustomError:
    """Return an error with a remedy; `see` is the location of the other field involved."""
    context: dict[str, str | Location] = {"problem": text, "remedy": remedy}
    if see is not None:
        context["see"] = see
    return PydanticCustomError("scenario", "{problem}; {remedy}", context)


@dataclass(frozen=True, slots=True)
class Finding:
    """An error at a location relative to the model that is being validated."""

    location: Location
    error: PydanticCustomError

    @classmethod
    def of(cls, location: Location, text: str, remedy: str, see: Location | None = None) -> "Finding":
        """Return a finding from the texts of its error, see `problem`."""
        return cls(location, problem(text, remedy, see))


def as_error(*findings: Finding) -> ValidationError:
    """Return one validation error with all findings."""
    details = [InitErrorDetails(type=f.error, loc=f.location, input=None) for f in findings]
    return ValidationError.from_exception_data("file", details)


def raise_findings(findings: Sequence[Finding]) -> None:
    """Raise all findings as one validation error; do nothing if there are none."""
    if findings:
        raise as_error(*findings)


def nearest(name: str, names: Sequence[str]) -> str:
    """Return a remedy: the name nearest to `name`, or all names if none is near."""
    close = get_close_matches(shorten(name), names, n=1, cutoff=0.6)
    if close:
        return f"did you mean '{close[0]}'?"
    return f"known: {', '.join(names)}"


class Model(BaseModel):
    """Base of every part of a scenario: frozen, strict, without unknown keys, all numbers finite."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    def instance(self) -> object:
        """Return the object that this model describes: itself, unless it is derived from a declaration."""
        return self

    @classmethod
    def key_names(cls) -> list[str]:
        """Return the keys as written in a scenario file."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @classmethod
    def unknown_key(cls, key: str) -> PydanticCustomError:
        """Return the error for a key that this model does not have."""
        return problem(f"unknown key {show(key)}", nearest(key, cls.key_names()))

    @classmethod
    def tolerates(cls, key: str, value: object) -> bool:
        """Tell whether a key that this model does not have is accepted and ignored."""
        del key, value
        return False

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, data: object) -> object:
        # Unknown keys before missing ones, so that a misspelt required key is reported as misspelt.
        if not isinstance(data, Mapping):
            return data
        own = set(cls.key_names())
        unknown = [key for key, value in data.items() if key not in own and not cls.tolerates(key, value)]
        raise_findings([Finding((str(key),), cls.unknown_key(str(key))) for key in unknown])
        required = {field.alias or name: field for name, field in cls.model_fields.items() if field.is_required()}
        missing = {key: field.description for key, field in required.items() if key not in data}
        raise_findings(
            [Finding.of((key,), f"'{key}' is missing", f"add '{key}: ...' ({what})") for key, what in missing.items()],
        )
        return {key: value for key, value in data.items() if key in own}


def schema_of(model: type[Model], title: str) -> dict[str, object]:
    """Return the JSON Schema (2020-12) of the files that a model describes."""
    schema = model.model_json_schema(by_alias=True, mode="validation")
    return {**schema, "$schema": "https://json-schema.org/draft/2020-12/schema", "title": title}


def not_tiny(value: float) -> float:
    """Reject a positive number below `SMALLEST`."""
    if value < SMALLEST:
        raise problem(f"{value!r} is too small", f"give a number of at least {SMALLEST}")
    return value


def _without_negative_zero(value: float) -> float:
    return value + 0.0


WithoutNegativeZero = AfterValidator(_without_negative_zero)
"""Turns -0.0 into 0.0, so that equal scenarios give equal bytes."""

Number: TypeAlias = Annotated[float, Field(ge=-LARGEST, le=LARGEST), WithoutNegativeZero]
NonNegative: TypeAlias = Annotated[float, Field(ge=0, le=LARGEST), WithoutNegativeZero]
Positive: TypeAlias = Annotated[float, Field(gt=0, le=LARGEST), AfterValidator(not_tiny)]


def to_nanoseconds(seconds: float) -> int:
    """Return `seconds` (s) as an integer number of nanoseconds, exactly as its decimal text says.

    Raises
    ------
    ValueError
        If the decimal is not a whole number of nanoseconds.
    """
    exact = Fraction(repr(seconds)) * SECOND
    if exact.denominator != 1:
        raise ValueError(f"{seconds!r} s is not a whole number of nanoseconds")
    return exact.numerator


def nearest_step(at: float, step_ns: int) -> int:
    """Return round(at/step): `at` in s, `step_ns` in ns, the ratio taken exactly, ties to the even step."""
    return round(Fraction(repr(at)) * SECOND / step_ns)


def _whole_nanoseconds(seconds: float) -> float:
    try:
        to_nanoseconds(seconds)
    except ValueError as exc:
        raise problem(str(exc), "give at most nine decimals, e.g. 0.01") from None
    return seconds + 0.0


WholeNanoseconds = AfterValidator(_whole_nanoseconds)
Duration: TypeAlias = Annotated[float, Field(gt=0, le=LONGEST_TIME), WholeNanoseconds]
"""A positive time in s that is a whole number of nanoseconds."""


WORD = r"[A-Za-z_][A-Za-z0-9_]*"


def matching(pattern: str, what: str, remedy: str, longest: int = 255) -> AfterValidator:
    """Return a validator of texts that match a pattern completely; `what` names such a text in errors."""
    expression = re.compile(pattern)

    def check(text: str) -> str:
        if not expression.fullmatch(text) or len(text) > longest:
            raise problem(f"{show(text)} is not a valid {what}", remedy)
        return text

    return AfterValidator(check)


TopicName: TypeAlias = Annotated[
    str, matching(rf"(/?{WORD}(/{WORD})*)?", "topic name", "write e.g. /odom; letters, digits, _ and /")
]
"""A topic; an empty name means one below the node's own name."""
FrameName: TypeAlias = Annotated[
    str, matching(r"[A-Za-z0-9_./-]*", "frame or joint name", "use letters, digits, '_', '.', '-' and '/'")
]

LONGEST_FILE_NAME = 32
"""Longest name of a fleet or host, which becomes part of the names of units and folders."""
Name: TypeAlias = Annotated[
    str,
    matching(
        r"[A-Za-z0-9][A-Za-z0-9_-]*",
        "name for folders and units",
        f"use 1 to {LONGEST_FILE_NAME} letters, digits, - and _, starting with a letter or a digit",
        LONGEST_FILE_NAME,
    ),
]
"""A fleet or a host."""

TEXTS: dict[str, object] = {"name": Name, "topic": TopicName, "frame": FrameName}
"""Type of a setting by what its text names."""

SCHEMA_VERSION = 1
"""The newest version of the files; `loader.upgraded` converts older ones."""


def known_version(value: object) -> object:
    """Reject every version but the newest; a validator of fields."""
    if type(value) is int and value > SCHEMA_VERSION:
        raise problem(
            f"version {show(value)} is newer than the version {SCHEMA_VERSION} that this swarmabs reads",
            "update swarmabs",
        )
    if type(value) is not int or value != SCHEMA_VERSION:
        raise problem(f"expected {SCHEMA_VERSION}, found {describe(value)}", f"write 'schema: {SCHEMA_VERSION}'")
    return value


def as_tuple(length: int | None) -> Callable[[object], object]:
    """Return a validator that converts a list, of any length or of a given one, to a tuple."""

    def convert(value: object) -> object:
        wanted = "a list" if length is None else f"a list of {length} numbers"
        if not isinstance(value, list | tuple):
            raise problem(f"expected {wanted}, found {describe(value)}", f"write {wanted} in [ ]")
        if length is not None and len(value) != length:
            raise problem(f"expected {wanted}, found {describe(value)}", f"give exactly {length} numbers")
        return tuple(value)

    return convert


@dataclass(frozen=True, eq=False)
class OrNumber:
    """Annotation of a list that may be written as one number."""

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Put a number into a list."""
        number = (int, float)
        return core_schema.no_info_before_validator_function(
            lambda value: [value] if isinstance(value, number) and not isinstance(value, bool) else value,
            handler(source),
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Allow the items of the list in its place."""
        array = handler(schema)
        return {"anyOf": [array, array["items"]]}


AsTuple = BeforeValidator(as_tuple(None))
AsPair = BeforeValidator(as_tuple(2))


@dataclass(frozen=True, eq=False)
class Tagged:
    """Annotation of a field whose model is looked up in a registry by the value of its tag key.

    The registry is read at every validation, so models that are registered later are accepted too. Looking up one model
    does not load the others.

    Parameters
    ----------
    tag : str
        Name of the tag key.
    registry : mapping of str to type of Model
        The model of each value of the tag; instances of these models are accepted unchanged. A model derived from a
        declaration gives an instance of the declaration.
    default : str, optional
        Value of the tag when the key is left out; without it the key is required.
    retired : mapping of str to str
        The remedy for each value of the tag that no longer exists.
    """

    tag: str
    registry: Mapping[str, type[Model]]
    default: str | None = None
    retired: Mapping[str, str] = field(default_factory=dict)

    def validate(self, value: object) -> object:
        """Return the object that `value` describes, according to its registered model."""
        if is_dataclass(value) and hasattr(value, self.tag):
            value = self._tree(value)
        if isinstance(value, Model):
            model = self._find(getattr(value, self.tag, None))
            if model is not None and isinstance(value, model):
                return value
        if not isinstance(value, Mapping):
            raise problem(
                f"expected a mapping, found {describe(value)}",
                f"write {{{self.tag}: {next(iter(self.registry), 'NAME')}, ...}}",
            )
        name = value.get(self.tag, self.default)
        model = self._find(name)
        if model is not None:
            return model.model_validate(value).instance()
        names = list(self.registry)
        if name is None and self.tag not in value:
            raise problem(f"'{self.tag}' is missing", f"add '{self.tag}: ...', one of {', '.join(names) or 'none'}")
        text = show(name) if isinstance(name, str) else f"({describe(name)})"
        install = "install the package that provides it"
        given = name if isinstance(name, str) else ""
        remedy = self.retired.get(given) or (nearest(given, names) if names else install)
        error = Finding.of((self.tag,), f"unknown {self.tag} {text}", remedy)
        raise as_error(error)

    def _find(self, name: object) -> type[Model] | None:
        try:
            return self.registry.get(name) if isinstance(name, str) else None
        except PluginError as error:
            raise as_error(Finding.of((self.tag,), error.problem, error.remedy)) from error

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Validate by the registry and serialise by the model found."""
        shown = core_schema.wrap_serializer_function_ser_schema(
            lambda value, handle: self._tree(value) if is_dataclass(value) else handle(value),
            schema=core_schema.any_schema(),
        )
        return core_schema.no_info_before_validator_function(
            self.validate, core_schema.any_schema(), serialization=shown
        )

    def _tree(self, value: object) -> dict[str, object]:
        return {self.tag: getattr(value, self.tag), **tree_of(value)}

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Offer every registered model; the tag is required unless it is the default."""
        choices: list[JsonSchemaValue] = []
        for name, model in self.registry.items():
            choice = dict(handler(model.__pydantic_core_schema__))
            if name != self.default:
                choice["required"] = [self.tag, *choice.get("required", ())]
            choices.append(choice)
        return {"oneOf": choices} if choices else {"type": "object", "required": [self.tag]}
