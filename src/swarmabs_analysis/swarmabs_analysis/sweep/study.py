"""A sweep: the file that defines what varies, and the cases in a fixed order, each a set of overrides and a seed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from hashlib import sha256
from math import prod
from pathlib import Path
from statistics import NormalDist
from typing import Annotated, Any, Literal, TypeAlias, get_args

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from swarmabs_analysis.sweep.evaluate import Task
from swarmabs_config.model.errors import describe, show
from swarmabs_config.model.fields import (
    AsPair,
    AsTuple,
    Finding,
    Model,
    Number,
    Positive,
    known_version,
    nearest,
    problem,
    raise_findings,
)
from swarmabs_config.model.scenario import FolderName
from swarmabs_config.scenario import ScenarioError, parse_scenario
from swarmabs_config.scenario.dump import dump_tree
from swarmabs_config.scenario.loader import default_name, read_mapping, validated
from swarmabs_config.scenario.text_file import read_text
from swarmabs_config.scenario.yaml_tree import Node
from swarmabs_config.scenarios import DottedPath, as_override, at_parameter, find_scenario, named_scenario
from swarmabs_core.theory.state_feedback import ANGLE_MAX

PROBED = 64
"""Number of cases to try before a sweep is rejected because none is a valid scenario."""
SCENARIO_FILE = "scenario.yaml"
MOST_CASES = 1_000_000
Result: TypeAlias = Literal[
    "settled_at",
    "final_error",
    "rms_error",
    "max_abs_position",
    "max_abs_angle",
    "messages",
    "initial_error_squared",
    "in_printed_estimate",
    "in_corrected_estimate",
]
RESULTS: tuple[Result, ...] = get_args(Result)


class Range(Model):
    """Equally spaced values, both ends included."""

    start: Number = Field(alias="from", description="first value")
    stop: Number = Field(alias="to", description="last value")
    count: int = Field(ge=2, le=MOST_CASES, description="number of values")

    def values(self) -> list[int | float]:
        """Return the values, each rounded once from the exact decimal; as int if all are whole numbers."""
        start, stop = Fraction(repr(self.start)), Fraction(repr(self.stop))
        exact = [start + (stop - start) * n / (self.count - 1) for n in range(self.count)]
        if all(value.denominator == 1 for value in exact):
            return [int(value) for value in exact]
        return [float(value) for value in exact]


def _values(value: object) -> object:
    if isinstance(value, Mapping):
        value = Range.model_validate(value).values()
    if not isinstance(value, list | tuple):
        remedy = "write [value, ...] or {from: ..., to: ..., count: ...}"
        raise problem(f"expected a list of values, found {describe(value)}", remedy)
    if not value:
        raise problem("the list is empty", "give one or more values")
    seen: set[str] = set()
    for one in value:
        text = json.dumps(one, sort_keys=True)
        if text in seen:
            raise problem(f"the value {text[:60]} is given twice", "remove one of them")
        seen.add(text)
    return tuple(value)


Values: TypeAlias = Annotated[tuple[Any, ...], BeforeValidator(_values)]


def _ascending(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise problem(f"{pair[0]!r} is not below {pair[1]!r}", "write [smallest, largest]")
    return pair


def _positive_deviation(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[1] > 0:
        raise problem(f"the standard deviation is {pair[1]!r}", "write [mean, standard deviation], the latter above 0")
    return pair


class Distribution(Model):
    """The distribution of a random parameter: exactly one of the keys."""

    uniform: Annotated[tuple[Number, Number], AsPair, AfterValidator(_ascending)] | None = Field(
        default=None, description="[smallest, largest]"
    )
    normal: Annotated[tuple[Number, Number], AsPair, AfterValidator(_positive_deviation)] | None = Field(
        default=None, description="[mean, standard deviation]"
    )
    choice: Values | None = Field(default=None, description="values of equal probability")

    @model_validator(mode="after")
    def _check_one(self) -> Distribution:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            names = " and ".join(given) or "none"
            raise problem(f"expected one of uniform, normal and choice, found {names}", "keep exactly one")
        return self

    def draw(self, chance: float) -> Any:
        """Return the value for a uniformly distributed number in (0, 1)."""
        if self.uniform is not None:
            low, high = self.uniform
            return low + (high - low) * chance
        if self.normal is not None:
            return NormalDist(*self.normal).inv_cdf(chance)
        values = self.choice or ()
        return values[int(chance * len(values))]


class Attraction(Model):
    """Settings of the estimates of the region of attraction."""

    angle_max: Positive = Field(default=ANGLE_MAX, lt=1.5707963, description="bound theta_max of the angle, rad")


class Picture(Model):
    """The axes of the picture."""

    x: str = Field(description="parameter along the horizontal axis")
    y: str = Field(description="parameter along the vertical axis")


class Sweep(Model):
    """The complete description of a study, apart from its scenario.

    Every point of the grid is computed `samples` times, each with new random parameters and another seed.
    """

    schema_version: Annotated[Literal[1], BeforeValidator(known_version)] = Field(
        alias="schema", description="version of this file format: 1"
    )
    name: FolderName = Field(default="sweep", description="name of the sweep, by default the file's stem")
    scenario: str = Field(description="a built-in scenario, or a file, relative to this one")
    settings: dict[DottedPath, Any] = Field(
        default={}, alias="set", description="values that differ from the scenario's in all cases"
    )
    grid: dict[DottedPath, Values] = Field(default={}, description="parameters of which all combinations are computed")
    random: dict[DottedPath, Distribution] = Field(default={}, description="parameters drawn for each case")
    samples: int = Field(default=1, ge=1, le=MOST_CASES, description="cases per point of the grid")
    seed: int = Field(default=1, ge=0, lt=2**63, description="seed of everything random in the sweep")
    results: Annotated[tuple[Result, ...], AsTuple] = Field(default=RESULTS, description="columns to keep of each case")
    attraction: Attraction = Field(default=Attraction(), description="the estimates of the region of attraction")
    picture: Picture | None = Field(default=None, description="axes of the picture; by default the first two numbers")

    @model_validator(mode="after")
    def _check_together(self) -> Sweep:
        findings = [
            Finding.of(("random", path), "it is also in the grid", "remove one of the two", see=("grid", path))
            for path in self.random
            if path in self.grid
        ]
        if not self.parameters:
            findings.append(Finding.of((), "nothing is swept", "add e.g. 'grid: {plane.angle: [0.1, 0.2]}'"))
        if self.count > MOST_CASES:
            findings.append(Finding.of((), f"{self.count} cases are too many", f"use at most {MOST_CASES}"))
        if len(set(self.results)) < len(self.results):
            findings.append(Finding.of(("results",), "a result is listed twice", "list each once"))
        if self.picture is not None:
            axes = {"x": self.picture.x, "y": self.picture.y}
            findings += [
                Finding.of(("picture", axis), f"{show(path)} is not swept", nearest(path, self.parameters))
                for axis, path in axes.items()
                if path not in self.parameters
            ]
            if self.picture.x == self.picture.y:
                findings.append(Finding.of(("picture",), "both axes are the same parameter", "name two parameters"))
        raise_findings(findings)
        return self

    @property
    def parameters(self) -> tuple[str, ...]:
        """The swept parameters in the order of the file, those of the grid first."""
        return (*self.grid, *self.random)

    @property
    def count(self) -> int:
        """Number of cases."""
        return prod(len(values) for values in self.grid.values()) * self.samples


@dataclass(frozen=True, slots=True)
class Case:
    """One run of a sweep: index, the seed of its scenario, and the values of the swept parameters by path."""

    index: int
    seed: int
    values: Mapping[str, Any]

    def overrides(self) -> tuple[str, ...]:
        """Return the arguments of ``--set`` that run this case alone."""
        return (f"seed={self.seed}", *(as_override(path, value) for path, value in self.values.items()))


@dataclass(frozen=True)
class Study:
    """A sweep and the scenario that all its cases are based on.

    The scenario is resolved YAML text, except that generated robots are not generated yet.
    """

    sweep: Sweep
    scenario: str

    @property
    def sweep_text(self) -> str:
        """The sweep as YAML with every default filled in; it refers to the scenario's text in `SCENARIO_FILE`."""
        data = self.sweep.model_dump(mode="json", by_alias=True, exclude={"settings"})
        data["scenario"] = SCENARIO_FILE
        data["random"] = {
            path: drawn.model_dump(exclude_none=True, mode="json") for path, drawn in self.sweep.random.items()
        }
        return dump_tree({key: value for key, value in data.items() if value is not None})

    def case(self, index: int) -> Case:
        """Return a case; samples vary fastest, then the last parameter of the grid.

        Its random values depend only on the sweep's seed, the index and, for drawn parameters, their path.
        """
        sweep = self.sweep
        point, values = index // sweep.samples, {}
        for path, choices in reversed(sweep.grid.items()):
            point, place = divmod(point, len(choices))
            values[path] = choices[place]
        values = dict(reversed(values.items()))
        for path, distribution in sweep.random.items():
            values[path] = distribution.draw(_chance(sweep.seed, index, path))
        return Case(index, _hash(sweep.seed, index, "seed") >> 1, values)

    def cases(self) -> Iterator[Case]:
        """Return all cases in order."""
        return (self.case(index) for index in range(self.sweep.count))

    def task(self, index: int) -> Task:
        """Return the task that computes a case."""
        return Task(self.scenario, index, self.case(index).overrides(), self.sweep.attraction.angle_max)


def load_sweep(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Study:
    """Read a sweep file in YAML, whose stem is the default of ``name``, and its scenario.

    Overrides ``a.b=v`` of the scenario are applied after those of the file.

    Raises
    ------
    InputError
        If the sweep or its scenario is invalid, or no case of it is a valid scenario.
    """
    path = Path(path)
    root = read_mapping(read_text(path, "sweep"), str(path), "sweep")
    data = root.plain()
    if isinstance(data, dict):
        data.setdefault("name", default_name(path.stem))
    sweep = validated(Sweep, data, root)
    settings = [as_override(name, value) for name, value in sweep.settings.items()]
    try:
        scenario = find_scenario(named_scenario(sweep.scenario, path.parent), (*settings, *overrides))
    except ScenarioError as error:
        raise at_parameter(error, root, {"set": sweep.settings}) from error
    tree = scenario.model_dump(mode="json", by_alias=True)
    tree["swarm"] = {key: value for key, value in tree["swarm"].items() if value is not None}
    study = Study(sweep, dump_tree(tree))
    _refuse_invalid(study, root)
    return study


def _refuse_invalid(study: Study, root: Node) -> None:
    """Raise an error for a sweep without a valid case, such as one with a misspelt path."""
    first = _invalidity(study, 0)
    probed = range(0, study.sweep.count, max(1, study.sweep.count // PROBED))
    if first is not None and all(_invalidity(study, index) for index in probed):
        raise at_parameter(first, root, {"grid": study.sweep.grid, "random": study.sweep.random}) from first


def _invalidity(study: Study, index: int) -> ScenarioError | None:
    """Return why a case is not a valid scenario, or None."""
    try:
        parse_scenario(study.scenario, overrides=study.case(index).overrides())
    except ScenarioError as error:
        return error
    return None


def _hash(seed: int, index: int, purpose: str) -> int:
    """Return 64 bits that depend only on the arguments."""
    digest = sha256(f"swarmabs sweep\0{seed}\0{index}\0{purpose}".encode()).digest()
    return int.from_bytes(digest[:8], "big")


def _chance(seed: int, index: int, path: str) -> float:
    """Return a number in (0, 1): the middle of one of 2^52 equal parts."""
    return ((_hash(seed, index, f"value of {path}") >> 12) + 0.5) / 2**52
