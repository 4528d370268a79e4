"""Node of a lower plane's controller, which follows an upper robot."""

from __future__ import annotations

import sys

from coupled_node import PARAMETERS, make_controller

from swarmabs_ros.runner import LockstepProgram

main = LockstepProgram("led_controller", PARAMETERS, make_controller)


if __name__ == "__main__":
    sys.exit(main())
