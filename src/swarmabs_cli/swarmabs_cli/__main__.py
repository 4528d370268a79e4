"""``python -m swarmabs_cli``."""

import sys

from swarmabs_cli import main

if __name__ == "__main__":
    sys.exit(main())
