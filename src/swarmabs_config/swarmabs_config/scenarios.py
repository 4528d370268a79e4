"""The built-in scenarios, and how commands and files name a scenario and override its values."""

from __future__ import annotations

import difflib
import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from pydantic import AfterValidator

from swarmabs_config.installation import shared
from swarmabs_config.model.errors import show
from swarmabs_config.model.fields import problem
from swarmabs_config.scenario import PlaneScenario, Scenario, ScenarioError, load_scenario, on_plane
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from swarmabs_config.scenario.yaml_tree import Node

LONGEST_PATH = 80
OWN = {
    "schema": "it is the version of the file format",
    "name": "the name is that of the sweep",
    "seed": "every case has its own seed, drawn from the sweep's",
}
"""Keys of a scenario that cannot be swept, and why."""

_PATH = re.compile(r"[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*")

DEFAULT = "pd_het_4"
"""The scenario that runs by default."""


def builtin_folder() -> Path:
    """Return the folder of the built-in scenarios: the installed one, or that of the sources."""
    sources = Path(__file__).resolve().parents[2] / "swarmabs_bringup" / "scenarios"
    return shared("swarmabs_bringup", "scenarios") or sources


def builtin_scenarios() -> dict[str, Path]:
    """Return the files of the built-in scenarios by name."""
    return {path.stem: path for path in sorted(builtin_folder().glob("*.yaml"))}


def load_builtin(name: str) -> PlaneScenario:
    """Load a built-in scenario; all of them are on the plane."""
    return on_plane(load_scenario(builtin_scenarios()[name]), "the list of built-in scenarios")


def described(path: Path) -> tuple[str, str]:
    """Return a built-in scenario's description and its figure of the paper, from the first two lines of its file."""
    first, second, *_ = path.read_text(encoding="utf-8").splitlines()
    return first.removeprefix("# "), second.removeprefix("# Figure: ")


def find_scenario(named: str, overrides: Sequence[str] = ()) -> Scenario:
    """Load the built-in scenario or the YAML file that a user has named, with overrides ``a.b=value``.

    Raises
    ------
    InputError
        If it does not exist or is invalid.
    """
    builtin = builtin_scenarios()
    if named in builtin:
        return load_scenario(builtin[named], overrides)
    path = Path(named)
    if path.exists() or path.suffix in {".yaml", ".yml"} or os.sep in named:
        return load_scenario(path, overrides)
    if "=" in named:
        raise InputError(f"no built-in scenario or file {named!r}", f"to change a value, write --set '{named}'")
    close = difflib.get_close_matches(named, builtin, n=1)
    hint = f"did you mean {close[0]}?" if close else f"name a YAML file or one of {', '.join(builtin)}"
    raise InputError(f"no built-in scenario or file {named!r}", hint)


def names_bag(named: str) -> bool:
    """Tell whether a user has named a bag, whose recorded scenario is meant."""
    path = Path(named)
    return named not in builtin_scenarios() and (path.suffix == ".mcap" or path.is_dir())


def _check_path(path: str) -> str:
    parts = path.split(".")
    if parts[0] in OWN:
        raise problem(f"{show(path)} cannot be swept: {OWN[parts[0]]}", "remove it")
    if not _PATH.fullmatch(path) or len(path) > LONGEST_PATH:
        raise problem(f"{show(path)} is not a dotted path", "write e.g. plane.angle or swarm.agents.0.mass")
    return path


DottedPath: TypeAlias = Annotated[str, AfterValidator(_check_path)]
"""A path into a scenario, as in ``--set``."""


def as_override(path: str, value: object) -> str:
    """Return the override that sets a value."""
    return f"{path}={json.dumps(value, ensure_ascii=False)}"


def named_scenario(scenario: str, folder: Path) -> str:
    """Resolve a scenario that is named in a file: paths are relative to the folder of that file."""
    if scenario in builtin_scenarios() or not (os.sep in scenario or Path(scenario).suffix):
        return scenario
    return str(folder / scenario)


def at_parameter(error: ScenarioError, root: Node, parts: Mapping[str, Iterable[str]]) -> ScenarioError:
    """Return the error of an override, with the line of the file that contains the override."""
    for part, paths in parts.items():
        for path in paths:
            if error.source.startswith(f"--set {path}="):
                mark, _ = root.locate((part, path))
                given = error.source.removeprefix("--set ")
                return ScenarioError(
                    mark.source, f"{given}: {error.problem}", error.remedy, line=mark.line, field=error.field
                )
    return error
