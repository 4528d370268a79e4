"""``python -m swarmabs_bringup.cli``."""

import sys

from swarmabs_bringup.cli import main

if __name__ == "__main__":
    sys.exit(main())
