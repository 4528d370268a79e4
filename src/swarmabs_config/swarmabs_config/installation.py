"""What this installation of swarmabs is: its version, its command, and the files that come with it.

There are two kinds. A ROS workspace, as the checkout sets it up, has all packages and finds their files below its ROS
prefixes. The wheel has what needs no ROS, and these files in the folder `WHEEL_FILES`.
"""

from __future__ import annotations

import os
import re
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from swarmabs_core.errors import InputError

WHEEL_FILES = Path(__file__).with_name("wheel")
"""Prefix of shared files in the wheel, which only the wheel has."""
IS_WHEEL = WHEEL_FILES.is_dir()
COMMAND = "swarm" if IS_WHEEL else "./scripts/swarm"
"""The program by which users start the command line."""
DISTRIBUTION = "swarmabs" if IS_WHEEL else "swarmabs_core"
"""The installed distribution whose version is that of swarmabs."""

EXTRAS = {
    "aiohttp": "view",
    "cryptography": "deploy",
    "dask": "sweeps",
    "distributed": "sweeps",
    "matplotlib": "plots",
    "pyarrow": "sweeps",
    "scipy": "matlab",
}
"""Modules that only some commands need, and the extra of the wheel that installs each."""
_OTHERS = {"foxglove": "foxglove-sdk"}
"""Such modules that only commands with ROS need, and their distributions."""
_ROS = re.compile(r"rclpy|ros\w*|rcl_\w+|\w+_msgs|\w+_interfaces|ament_\w+|swarmabs_ros|agent_node|plane_sim")
"""Modules that come with ROS 2 or with a workspace of it."""


def own_version() -> str | None:
    """Return the version of swarmabs; None if it runs from sources that have not been built."""
    try:
        return version(DISTRIBUTION)
    except PackageNotFoundError:
        return None


def prefixes() -> list[Path]:
    """Return the prefixes below which packages share files: the wheel's own, those of ROS, and that of Python.

    ROS wheels install below Python's prefix.
    """
    sourced = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    return [*([WHEEL_FILES] if IS_WHEEL else []), *map(Path, sourced), Path(sys.prefix)]


def shared(*parts: str) -> Path | None:
    """Return the first shared file or folder ``PREFIX/share/PARTS``; None if no prefix has it."""
    return next((path for prefix in prefixes() if (path := prefix.joinpath("share", *parts)).exists()), None)


def lacking(error: ModuleNotFoundError, user: str) -> ModuleNotFoundError | InputError:
    """Return what to raise instead of an error for a missing module: what needs it, and how to get it.

    That is the error itself if the module is neither optional nor part of ROS.
    """
    module = (error.name or "").partition(".")[0]
    if _ROS.fullmatch(module):
        return InputError(
            f"{user} needs ROS 2, which this Python does not have (no module {module})",
            "use ./scripts/swarm of a checkout, which installs it, or source ROS 2 Jazzy and a workspace with swarmabs",
        )
    if module not in EXTRAS and module not in _OTHERS:
        return error
    distribution = _OTHERS.get(module, module)
    package = f'"swarmabs[{EXTRAS[module]}]"' if IS_WHEEL else distribution
    elsewhere = "" if IS_WHEEL else "./scripts/swarm installs it by itself; elsewhere: "
    remedy = f"{elsewhere}{sys.executable} -m pip install {package}"
    return InputError(f"{user} needs the Python package {distribution}", remedy)
