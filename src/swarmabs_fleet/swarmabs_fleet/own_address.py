"""Says by its exit code whether this host has an address: ``python -m swarmabs_fleet.own_address ADDRESS``.

Units ask before they start a node: without its interface Fast DDS hears nobody, also when the interface comes later.
"""

from __future__ import annotations

import socket
import sys


def main(arguments: list[str]) -> int:
    """Return 0 if the one address in the arguments is this host's, else 1, saying why."""
    if len(arguments) != 1:
        print("own_address: give one address", file=sys.stderr)  # noqa: T201 - it is a program
        return 1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((arguments[0], 0))
        except OSError as error:
            print(f"own_address: {arguments[0]}: {error.strerror}; is its interface up?", file=sys.stderr)  # noqa: T201
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
