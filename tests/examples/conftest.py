"""The programs in examples/ import their neighbours as scripts do: by the search path."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "cascade"))
