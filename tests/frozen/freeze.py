"""Freeze anew what is frozen here, where it is meant to change: ``python -m tests.frozen.freeze digests``."""

import json
import sys
import tempfile
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from tests.frozen import commands, digests, pictures
from tests.frozen.command import FOLDER


def _commands(folder: Path) -> dict[str, Any]:
    names, found = commands.prepare(folder), {}
    for during in (*commands.DURING, None):
        chosen = [name for name, case in commands.CASES.items() if case.get("during") == during]
        with commands.going_on(during, folder) if during else nullcontext("") as run:
            names["run_going_on"] = run
            for name in chosen:
                done = commands.run_case(name, folder, names)
                found[name] = {**commands.CASES[name], **commands.outcome(name, done, folder)}
    return {name: found[name] for name in commands.CASES}


FROZEN: dict[str, Callable[[Path], dict[str, Any]]] = {
    "digests": lambda folder: {n: {**case, "summary": digests.summary(n, folder)} for n, case in digests.CASES.items()},
    "fleets": lambda _: {n: {**case, "found": digests.of_fleet(n)} for n, case in digests.FLEETS.items()},
    "commands": _commands,
    "pictures": lambda folder: {name: pictures.found(name, folder / name) for name in pictures.CASES},
}


def main(names: list[str]) -> None:
    """Write the files NAME.json of the names given."""
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            found = FROZEN[name](Path(folder))
        lines = ",\n".join(f" {json.dumps(case)}: {json.dumps(facts)}" for case, facts in found.items())
        (FOLDER / f"{name}.json").write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
