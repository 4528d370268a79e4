"""The scenarios that come with the package, and how a scenario is named on the command line."""

from __future__ import annotations

import difflib
import os
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_config.scenario import load_scenario
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_config.scenario import Scenario

DEFAULT = "pd_het_4"
"""What runs when nothing is said."""


def builtin_folder() -> Path:
    """Return the folder of the built-in scenarios: the installed one, or that of the sources."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        folder = Path(prefix) / "share" / "swarmabs_bringup" / "scenarios"
        if prefix and folder.is_dir():
            return folder
    return Path(__file__).resolve().parents[2] / "swarmabs_bringup" / "scenarios"


def builtin_scenarios() -> dict[str, Path]:
    """Return the files of the built-in scenarios by name."""
    return {path.stem: path for path in sorted(builtin_folder().glob("*.yaml"))}


def find_scenario(named: str, overrides: Sequence[str] = ()) -> Scenario:
    """Load what a user has named.

    Parameters
    ----------
    named : str
        A built-in scenario, a YAML file, or a bag (a run's folder, its ``bag/`` or an ``.mcap`` file), whose own
        scenario is then taken.
    overrides : sequence of str
        ``a.b=value`` each.

    Raises
    ------
    InputError
        If there is no such thing, or it is not valid.
    """
    builtin = builtin_scenarios()
    if named in builtin:
        return load_scenario(builtin[named], overrides)
    path = Path(named)
    if names_bag(named):
        return _scenario_of_bag(path, overrides)
    if path.exists() or path.suffix in {".yaml", ".yml"} or os.sep in named:
        return load_scenario(path, overrides)
    close = difflib.get_close_matches(named, builtin, n=1)
    hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(builtin)}"
    raise InputError(f"no scenario or file {named!r}; {hint}")


def names_bag(named: str) -> bool:
    """Say whether `find_scenario` takes what a user has named for a bag."""
    path = Path(named)
    return named not in builtin_scenarios() and (path.suffix == ".mcap" or path.is_dir())


def _scenario_of_bag(path: Path, overrides: Sequence[str]) -> Scenario:
    from swarmabs_bag.attached import attached_scenario  # noqa: PLC0415
    from swarmabs_bag.reader import open_bag  # noqa: PLC0415 - only needed for bags

    return attached_scenario(open_bag(path, several=True), overrides)
