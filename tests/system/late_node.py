"""A robot, or several in a process, which ends at once the first time that it is started."""

import os
import sys

import agent_node.group
import agent_node.node


def main(arguments: list[str]) -> int:
    """Run the node, unless nothing is in its log yet."""
    if os.fstat(1).st_size == 0:
        sys.stdout.write("not today\n")
        return 3
    shared = any(word.startswith("agent_ids:=") for word in arguments)
    return agent_node.group.main(arguments) if shared else agent_node.node.main(arguments)
