"""A robot whose process ends at once the first time that it is started."""

from __future__ import annotations

import os
import sys

import agent_node.node


def main(arguments: list[str]) -> int:
    """Run the node, unless nothing is in its log yet."""
    if os.fstat(1).st_size == 0:
        sys.stdout.write("not today\n")
        return 3
    return agent_node.node.main(arguments)
