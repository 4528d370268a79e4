"""Give a process that a test starts the code of the mutant that is tried: Python imports this before all else."""

import marshal
import os
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType

if "SWARMABS_MUTANT" in os.environ:
    mutated: CodeType = marshal.loads(Path(os.environ["SWARMABS_MUTANT"]).read_bytes())
    usual = SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, name: str) -> CodeType | None:
        """Return the code of a module, with the change if it is the mutant's."""
        return mutated if loader.path == mutated.co_filename else usual(loader, name)

    SourceFileLoader.get_code = get_code  # type: ignore[method-assign]
