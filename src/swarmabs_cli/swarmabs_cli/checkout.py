"""The checkout, for commands that need more of it than what is installed."""

from __future__ import annotations

import sys
from pathlib import Path

from swarmabs_core.errors import InputError


def checkout() -> Path:
    """Return the checkout in which, or from which, the command was started.

    Raises
    ------
    InputError
        If there is none.
    """
    for start in (Path.cwd(), Path(sys.prefix)):
        for folder in (start, *start.parents):
            if (folder / "scripts" / "swarm").is_file() and (folder / "tests").is_dir():
                return folder
    raise InputError("no checkout of swarmabs found here; change into one")
