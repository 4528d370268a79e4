"""Freeze anew what is frozen here, where it is meant to change: ``python -m tests.frozen.freeze digests``."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.frozen import digests, fleets
from tests.frozen.command import FOLDER


def _digests(folder: Path) -> dict[str, Any]:
    return {name: {**case, "summary": digests.summary(name, folder)} for name, case in digests.CASES.items()}


def _fleets(_folder: Path) -> dict[str, Any]:
    return {name: {**case, "found": fleets.digest(name)} for name, case in fleets.CASES.items()}


FROZEN: dict[str, Callable[[Path], dict[str, Any]]] = {"digests": _digests, "fleets": _fleets}


def main(names: list[str]) -> None:
    """Write the files NAME.json of the names given."""
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            found = FROZEN[name](Path(folder))
        (FOLDER / f"{name}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
