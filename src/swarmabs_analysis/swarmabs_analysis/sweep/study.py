"""A sweep with its scenario: the cases, each a set of overrides and a seed, in a fixed order."""

from __future__ import annotations

import os
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.sweep.model import Sweep
from swarmabs_config.scenario import ScenarioError, parse_scenario
from swarmabs_config.scenario.dump import dump_tree
from swarmabs_config.scenario.loader import default_name, read_mapping, validated
from swarmabs_config.scenario.text_file import read_text
from swarmabs_config.scenarios import as_override, at_parameter, find_scenario, named_scenario

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from swarmabs_config.scenario import Scenario
    from swarmabs_config.scenario.yaml_tree import Node

PROBED = 64
"""How many cases are tried before a sweep is refused because none of its cases is a valid scenario."""
SCENARIO_FILE = "scenario.yaml"


@dataclass(frozen=True, slots=True)
class Case:
    """One run of a sweep.

    Parameters
    ----------
    index : int
        Its place in the sweep, from 0.
    seed : int
        The scenario's seed.
    values : mapping
        Values of the swept parameters by path.
    """

    index: int
    seed: int
    values: Mapping[str, Any]

    def overrides(self) -> tuple[str, ...]:
        """Return what ``--set`` would be given to run this case alone."""
        return (f"seed={self.seed}", *(as_override(path, value) for path, value in self.values.items()))


@dataclass(frozen=True)
class Study:
    """A sweep and the text of its scenario, which all cases are made from.

    Parameters
    ----------
    sweep : Sweep
        What is swept.
    scenario : str
        The scenario in YAML with every default filled in; generated robots are left to generate.
    """

    sweep: Sweep
    scenario: str

    @property
    def sweep_text(self) -> str:
        """The sweep in YAML with every default filled in; it belongs beside the scenario's text."""
        data = self.sweep.model_dump(mode="json", by_alias=True, exclude={"settings"})
        data["scenario"] = SCENARIO_FILE
        data["random"] = {
            path: drawn.model_dump(exclude_none=True, mode="json") for path, drawn in self.sweep.random.items()
        }
        return dump_tree({key: value for key, value in data.items() if value is not None})

    def case(self, index: int) -> Case:
        """Return a case: the last parameter of the grid varies fastest but for the samples.

        What is random in it depends on the sweep's seed, the index and, for drawn parameters, their path only.
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


def load_sweep(path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Study:
    """Read a sweep file and its scenario.

    Parameters
    ----------
    path : path-like
        A YAML file in UTF-8; its stem is the default of ``name``.
    overrides : sequence of str
        Overrides ``a.b=v`` of the scenario; they come after those of the file.

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
    study = Study(sweep, _scenario_text(scenario))
    _refuse_invalid(study, root)
    return study


def _scenario_text(scenario: Scenario) -> str:
    data = scenario.model_dump(mode="json", by_alias=True)
    data["swarm"] = {key: value for key, value in data["swarm"].items() if value is not None}
    return dump_tree(data)


def _refuse_invalid(study: Study, root: Node) -> None:
    """Refuse a sweep none of whose cases is valid, as one with a misspelt path."""
    first = _invalidity(study, 0)
    probed = range(0, study.sweep.count, max(1, study.sweep.count // PROBED))
    if first is not None and all(_invalidity(study, index) for index in probed):
        raise at_parameter(first, root, {"grid": study.sweep.grid, "random": study.sweep.random}) from first


def _invalidity(study: Study, index: int) -> ScenarioError | None:
    """Return why a case is no valid scenario, None if it is one."""
    try:
        parse_scenario(study.scenario, overrides=study.case(index).overrides())
    except ScenarioError as error:
        return error
    return None


def _hash(seed: int, index: int, purpose: str) -> int:
    """Return 64 bits that depend on nothing else."""
    digest = sha256(f"swarmabs sweep\0{seed}\0{index}\0{purpose}".encode()).digest()
    return int.from_bytes(digest[:8], "big")


def _chance(seed: int, index: int, path: str) -> float:
    """Return a number in (0, 1): the middle of one of 2^52 equal parts."""
    return ((_hash(seed, index, f"value of {path}") >> 12) + 0.5) / 2**52
