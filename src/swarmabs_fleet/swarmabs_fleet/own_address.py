"""Check whether this host has an address: ``python -m swarmabs_fleet.own_address ADDRESS`` exits with 0 if so.

Units run it before they start a node: if the interface is down at the start, Fast DDS receives nothing, even after the
interface comes up.
"""

from __future__ import annotations

import socket
import sys


def main(arguments: list[str]) -> int:
    """Return 0 if the single address in the arguments belongs to this host; otherwise print the reason and return 1."""
    if len(arguments) != 1:
        print("own_address: give one address", file=sys.stderr)  # noqa: T201 - a command-line program
        return 1
    problem = problem_of(arguments[0])
    if problem:
        print(f"own_address: {arguments[0]}: {problem}; is its interface up?", file=sys.stderr)  # noqa: T201
        return 1
    return 0


def problem_of(address: str) -> str:
    """Return why this host cannot use an address, empty if it can."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, 0))
        except OSError as error:
            return error.strerror or str(error)
    return ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
