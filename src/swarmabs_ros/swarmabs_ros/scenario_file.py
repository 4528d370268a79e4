"""The scenario file of a run, for the few nodes that need all of it: reading it takes most of the memory of a node."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_config.scenario import load_scenario
from swarmabs_core.declaration import setting
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario


@dataclass(frozen=True, slots=True)
class ScenarioFile:
    """The scenario of a run, for a node that needs all of it."""

    scenario_file: str = setting("", "file of the resolved scenario")

    def load(self) -> Scenario:
        """Return the scenario; raises `InputError` if no file is given or it is not valid."""
        if not self.scenario_file:
            raise InputError("parameter scenario_file is empty: give the file of the resolved scenario")
        return load_scenario(Path(self.scenario_file))
