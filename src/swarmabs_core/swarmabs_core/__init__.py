"""The paper as software: kernels, state machines of the nodes and theory, without ROS, clocks or files.

The kernels are pure functions of numbers: the sums of the swarm (`abstraction`), the decision of one robot
(`robot_controller` with `swarm_law`) and its motion (`drive`), the plane over a period (`plant`) and the desired
abstract state (`desired_state` with `controllers`). The caller selects the messages that enter: the state machines of
`behaviours` gather all messages of a step, those of `realtime` the newest validated ones. The simulation on arrays and
the verification of bags call the same functions.
"""

from importlib import import_module
from typing import Any


def __getattr__(name: str) -> Any:
    """Provide `simulate`, which moved to `swarmabs_run.simulation`, to scripts that import it from here."""
    if name == "simulate":
        return import_module("swarmabs_run.simulation").simulate
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
