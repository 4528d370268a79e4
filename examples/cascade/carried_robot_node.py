"""Node of an upper robot, driven by a lower plane."""

from __future__ import annotations

import sys

from coupled_node import PARAMETERS, make_robot

from swarmabs_ros.runner import run_node


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node("carried_robot", PARAMETERS, make_robot, args)


if __name__ == "__main__":
    sys.exit(main())
