"""Node of an upper robot, driven by a lower plane."""

from __future__ import annotations

import sys

from coupled_node import PARAMETERS, make_robot

from swarmabs_ros.runner import LockstepProgram

main = LockstepProgram("carried_robot", PARAMETERS, make_robot)


if __name__ == "__main__":
    sys.exit(main())
