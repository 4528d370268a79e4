"""``python wheel_imports.py FOLDER PACKAGE...``: what of the wheel unpacked in a folder imports without ROS.

It writes, as JSON, the modules that do not import, each with the missing module, and the modules that are loaded then.
"""

import importlib
import json
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path


class Hidden(MetaPathFinder):
    """Hides top-level modules, as if they were not installed."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = set(names)

    def find_spec(self, fullname: str, *_: object) -> ModuleSpec | None:
        if fullname.partition(".")[0] in self._names:
            raise ModuleNotFoundError(f"No module named {fullname!r}", name=fullname)
        return None


def main(folder: Path, hidden: Sequence[str]) -> None:
    sys.path.insert(0, str(folder))
    sys.meta_path.insert(0, Hidden(hidden))
    missing = {}
    for path in sorted(folder.glob("swarmabs_*/**/*.py")):
        parts = path.relative_to(folder).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        if parts[-1] != "__main__":
            try:
                importlib.import_module(name)
            except ModuleNotFoundError as error:
                missing[name] = error.name
    json.dump({"missing": missing, "loaded": [*sys.modules]}, sys.stdout)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
