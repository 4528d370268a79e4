"""Files that name a scenario and change values of it: sweeps and fleets."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, TypeAlias

from pydantic import AfterValidator

from swarmabs_config.scenario import ScenarioError
from swarmabs_config.scenario.errors import show
from swarmabs_config.scenario.fields import problem
from swarmabs_config.scenario.yaml_tree import Node
from swarmabs_config.scenarios import builtin_scenarios

LONGEST_PATH = 80
OWN = {
    "schema": "it is the version of the file format",
    "name": "the sweep has the name",
    "seed": "every case has a seed of its own, drawn from the sweep's",
}
"""Keys of a scenario that cannot be swept, and why."""

_PATH = re.compile(r"[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*")


def _check_path(path: str) -> str:
    parts = path.split(".")
    if parts[0] in OWN:
        raise problem(f"{show(path)} cannot be swept: {OWN[parts[0]]}", "remove it")
    if not _PATH.fullmatch(path) or len(path) > LONGEST_PATH:
        raise problem(f"{show(path)} is no dotted path", "write e.g. plane.angle, elements of lists by index")
    return path


DottedPath: TypeAlias = Annotated[str, AfterValidator(_check_path)]
"""A path into a scenario, as ``--set`` takes it."""


def as_override(path: str, value: object) -> str:
    """Return the override that sets a value."""
    return f"{path}={json.dumps(value, ensure_ascii=False)}"


def named_scenario(scenario: str, folder: Path) -> str:
    """Return what a file in a folder means by a scenario that it names: files are relative to it."""
    if scenario in builtin_scenarios() or not (os.sep in scenario or Path(scenario).suffix):
        return scenario
    return str(folder / scenario)


def at_parameter(error: ScenarioError, root: Node, parts: Mapping[str, Iterable[str]]) -> ScenarioError:
    """Return the error of an override with the line of the file that the override comes from."""
    for part, paths in parts.items():
        for path in paths:
            if error.source.startswith(f"--set {path}="):
                mark, _ = root.locate((part, path))
                given = error.source.removeprefix("--set ")
                return ScenarioError(
                    mark.source, f"{given}: {error.problem}", error.remedy, line=mark.line, field=error.field
                )
    return error
