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
        A built-in scenario or a YAML file.
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
    if path.exists() or path.suffix in {".yaml", ".yml"} or os.sep in named:
        return load_scenario(path, overrides)
    close = difflib.get_close_matches(named, builtin, n=1)
    hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(builtin)}"
    raise InputError(f"no scenario or file {named!r}; {hint}")


def names_bag(named: str) -> bool:
    """Tell whether what a user has named for a scenario is a bag, whose own scenario is meant."""
    path = Path(named)
    return named not in builtin_scenarios() and (path.suffix == ".mcap" or path.is_dir())
