"""Node of a lower plane's controller, which follows an upper robot."""

from __future__ import annotations

import sys

from coupled_node import PARAMETERS, make_controller

from swarmabs_ros.runner import run_node


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node("led_controller", PARAMETERS, make_controller, args)


if __name__ == "__main__":
    sys.exit(main())
