"""Mathematics and node behaviours of swarmabs, without ROS."""

from importlib import import_module
from typing import Any


def __getattr__(name: str) -> Any:
    """Give `simulate`, which is in `swarmabs_run.simulation`, to scripts that look for it here."""
    if name == "simulate":
        return import_module("swarmabs_run.simulation").simulate
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
