"""Read scenarios into a checked `Scenario`; every error names file, line, field and remedy.

Other strict YAML files, such as sweeps, are read with the same functions.
"""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias, TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from swarmabs_config.model.errors import ScenarioError, describe, show
from swarmabs_config.model.fields import Finding, Location, Model, nearest, raise_findings
from swarmabs_config.model.scenario import LONGEST_NAME, RETIRED_FAULTS, PlaneScenario, Scenario, SystemScenario

from .checks import findings
from .overrides import apply_overrides
from .reference_file import with_rows
from .text_file import read_text
from .yaml_tree import Node, Plain, dotted, read_tree

_NUMERIC = re.compile(r"\s*[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\s*")
_START = "start with 'schema: 1'"

Upgrade: TypeAlias = Callable[[dict[str, Plain]], dict[str, Plain]]
"""Converts the content of a scenario, without ``schema``, from one version to the next."""

UPGRADES: tuple[Upgrade, ...] = ()
"""The first converts schema 1 to schema 2, and so on; so far there is one version."""

AnyModel = TypeVar("AnyModel", bound=Model)


def load_scenario(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario file in YAML, whose stem is the default of ``name``, and apply overrides ``a.b=v`` in order.

    Raises
    ------
    ScenarioError
        If the file cannot be read or the scenario is invalid.
    """
    path = Path(path)
    text = read_text(path)
    return parse_scenario(
        text, source=str(path), default_name=default_name(path.stem), overrides=overrides, folder=path.parent
    )


def parse_scenario(
    text: str,
    *,
    source: str = "<text>",
    default_name: str = "scenario",
    overrides: Sequence[str] = (),
    folder: Path | None = None,
    recorded: bool = False,
) -> Scenario:
    """Read a scenario from a text in YAML.

    Parameters
    ----------
    text : str
        The scenario.
    source : str
        Its name in errors.
    default_name : str
        The scenario's name if the text has none.
    overrides : sequence of str
        Overrides ``a.b=v``, applied in order, see `apply_overrides`.
    folder : Path, optional
        Folder to which the file of a trajectory is relative; without it, the text cannot name a file.
    recorded : bool
        Whether it is the scenario of a bag. Its faults of retired kinds are left out: they changed nothing recorded.

    Raises
    ------
    ScenarioError
        If the scenario is invalid.
    """
    tree = read_mapping(text, source)
    if recorded:
        tree = tree.changed(("faults",), _without_retired)
    root = with_rows(apply_overrides(tree, overrides), folder)
    data = root.plain()
    if isinstance(data, dict):
        data = upgraded(data)
        data.setdefault("name", default_name)
    return validated(_model_of(data), data, root, findings)


def _without_retired(faults: Node) -> Node:
    """Return a list of faults without those of retired kinds."""
    if not isinstance(faults.value, tuple):
        return faults
    kinds = (fault.entries.get("kind") for fault in faults.value)
    kept = zip(faults.value, kinds, strict=True)
    return Node(tuple(one for one, kind in kept if kind is None or kind.node.value not in RETIRED_FAULTS), faults.mark)


def _model_of(data: Plain) -> type[Scenario]:
    """Return the model of a scenario, and remove the key ``system`` from one on the plane."""
    if not isinstance(data, dict) or "system" not in data:
        return PlaneScenario
    if data["system"] in ("plane", {"type": "plane"}):
        del data["system"]
        return PlaneScenario
    return SystemScenario


def read_mapping(text: str, source: str, kind: str = "scenario") -> Node:
    """Return the tree of a text in YAML that holds a mapping.

    Raises
    ------
    ScenarioError
        If it is not YAML, not plain data, too large, or no mapping.
    """
    root = read_tree(text, source)
    if root.value is None:
        raise root.mark.error(f"the {kind} is empty", _START)
    if not isinstance(root.value, Mapping):
        raise root.mark.error(f"expected a mapping, found {describe(root.value)}", f"{_START}, then 'key: value' lines")
    return root


def validated(
    model: type[AnyModel], data: Plain, root: Node, check: Callable[[AnyModel], Sequence[Finding]] = lambda _: ()
) -> AnyModel:
    """Return the model of `data`, which was read as `root`; `check` finds errors that involve several fields.

    Raises
    ------
    ScenarioError
        If it is invalid; the first error in order of the file.
    """
    try:
        content = model.model_validate(data)
        raise_findings(check(content))
    except ValidationError as exc:
        raise _first_error(exc, root) from exc
    return content


def upgraded(data: dict[str, Plain], upgrades: Sequence[Upgrade] = UPGRADES) -> dict[str, Plain]:
    """Return a scenario's content as one of the newest version, by one upgrade for each older one.

    Content without a known version is returned unchanged; the check of the fields rejects it.
    """
    version = data.get("schema")
    if type(version) is not int or not 1 <= version <= len(upgrades):
        return data
    for upgrade in upgrades[version - 1 :]:
        data = upgrade(data)
    return {**data, "schema": 1 + len(upgrades)}


def default_name(stem: str) -> str:
    """Return the name of a scenario whose file has this stem: the stem, made a valid name."""
    name = "".join("_" if c in "/\\" or not c.isprintable() else c for c in stem)
    if not name[:1].isalnum() and not name.startswith("_"):
        name = f"_{name}"
    return name[:LONGEST_NAME].rstrip(" ")


def _first_error(exc: ValidationError, root: Node) -> ScenarioError:
    """Return the first error: those of overrides come first, then those of the file by line."""
    errors = [_located(detail, root) for detail in exc.errors(include_url=False)]
    first = min(errors, key=lambda error: error.line or 0)
    first.more = len(errors) - 1
    return first


def _located(detail: ErrorDetails, root: Node) -> ScenarioError:
    """Return the error at its field; if two fields contradict each other, at the one that was overridden."""
    text, remedy = _explain(detail)
    own = _field(detail["loc"])
    fields: list[Location] = [own]
    if "see" in detail.get("ctx", {}):
        fields.append(detail["ctx"]["see"])
    given = [(field, mark) for field in fields for mark, present in [root.locate(field)] if present]
    if not given:
        given = [(own, root.locate(own)[0])]
    (field, mark), *others = sorted(given, key=lambda place: place[1].line is not None)
    for _, other in others:
        text += f" (see {other.source if other.line is None else f'line {other.line}'})"
    return ScenarioError(mark.source, text, remedy, line=mark.line, field=dotted(field))


def _field(location: Location) -> Location:
    """Return a location without pydantic's marker for the key of a mapping, as opposed to its value."""
    return location[:-1] if location[-1:] == ("[key]",) else location


def _explain(detail: ErrorDetails) -> tuple[str, str]:
    """Return problem and remedy of one validation error."""
    context = detail.get("ctx", {})
    value = detail["input"]
    kind = detail["type"]
    if kind == "scenario":
        return str(context["problem"]), str(context["remedy"])
    for name, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<=")):
        if name in context:
            bound = context[name]
            text = f"{bound:.12g}" if isinstance(bound, float) else str(bound)
            return f"{show(value)} is out of range", f"give a number {sign} {text}"
    if kind == "literal_error":
        expected = str(context["expected"])
        remedy = nearest(value, re.findall("'([^']*)'", expected)) if isinstance(value, str) else f"write {expected}"
        return f"expected {expected}, found {describe(value)}", remedy
    expected, remedy = _EXPECTED.get(kind, ("another value", detail["msg"]))
    if isinstance(value, str) and _NUMERIC.fullmatch(value) and "number" in expected:
        remedy = "remove the quotes"
    return f"expected {expected}, found {describe(value)}", remedy


_EXPECTED = {
    "float_type": ("a number", "write a number, e.g. 0.5"),
    "finite_number": ("a finite number", "write a number, e.g. 0.5"),
    "int_type": ("a whole number", "write a whole number, e.g. 1"),
    "string_type": ("a text", "put it in quotes"),
    "bool_type": ("true or false", "write true or false"),
    "model_type": ("a mapping", "write 'key: value' pairs, or leave it out"),
}
