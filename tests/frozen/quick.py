"""Check some frozen results in seconds, without pytest: ``python -m tests.frozen.quick``."""

import sys
import tempfile
from pathlib import Path

from tests.frozen.digests import chosen, difference, summary


def main() -> int:
    """Simulate the quick cases; return 1 and say what differs if one is not as frozen."""
    differing = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in chosen("quick"):
            if found := difference(name, summary(name, Path(folder), "simulate", "--no-bag")):
                differing += 1
                sys.stderr.write(f"{name}: frozen and found: {found}\n")
    sys.stdout.write(f"{len(chosen('quick')) - differing} of {len(chosen('quick'))} results as frozen\n")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
