"""How every node enters the middleware: by a Fast DDS profile that can be read, or not at all.

Fast DDS goes on without a profile that it cannot read, and then listens on every interface. Drivers' own programs,
which are none of these nodes, can ask beforehand: ``python -m swarmabs_ros.start`` ends with 2 and a line if it is so.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

import rclpy
from rclpy.signals import SignalHandlerOptions

from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables by which Fast DDS finds its profile; which of them counts depends on its version."""


def initialise(name: str, args: list[str] | None) -> None:
    """Start rclpy for a node that handles signals by itself.

    Parameters
    ----------
    name : str
        What errors call the node.
    args : list of str, optional
        Command line without the program's name.

    Raises
    ------
    InputError
        If the profile cannot be used, or the command line is not understood; nothing has been started then.
    """
    check_profiles(os.environ)
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # what the base of rclpy's own, not public errors is
        raise InputError(f"command line of {name}: {' '.join(str(error).split())}") from error


def check_profiles(environment: Mapping[str, str]) -> None:
    """Check that the profiles which an environment names can be read and are XML; none named is none to check.

    Raises
    ------
    InputError
        If not.
    """
    for variable in PROFILES:
        if path := environment.get(variable):
            _check(variable, Path(path))


def _check(variable: str, path: Path) -> None:
    """Check one profile."""
    consequence = "Fast DDS would listen on every interface without it"
    try:
        expat.ParserCreate().Parse(path.read_bytes(), True)
    except OSError as error:
        raise InputError(
            f"{variable}: {path} cannot be read: {error.strerror}, and {consequence}; "
            "let this account read it: start install.sh of the bundle again, or correct the variable"
        ) from error
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise InputError(
            f"{variable}: {path} is no XML: {' '.join(str(error).split())}, and {consequence}; "
            "make it anew: start install.sh of the bundle again, or correct the variable"
        ) from error


def main() -> int:
    """Check the profiles of this process's environment."""
    try:
        check_profiles(os.environ)
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
