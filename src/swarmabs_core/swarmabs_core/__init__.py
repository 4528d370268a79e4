"""The paper as software, without ROS, clock and files: kernels, state machines of the nodes, theory.

The kernels are functions of numbers, and each is stated once: the sums of the swarm (`abstraction`), what one robot
decides (`robot_controller` with `swarm_law`) and how it moves (`drive`), the plane over a period (`plant`), the desired
abstract state (`desired_state` with `controllers`). Who calls them decides which messages enter: the state machines of
`behaviours` gather all messages of a step, those of `realtime` the newest that can be believed. The simulation on
arrays and the verification of bags call the same functions.
"""

from importlib import import_module
from typing import Any


def __getattr__(name: str) -> Any:
    """Give `simulate`, which is in `swarmabs_run.simulation`, to scripts that look for it here."""
    if name == "simulate":
        return import_module("swarmabs_run.simulation").simulate
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
