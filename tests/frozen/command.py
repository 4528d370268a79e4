"""The command, in this process and as a process, and the frozen data beside this file."""

import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from swarmabs_cli import main
from swarmabs_core.controllers import CONTROLLERS

CLI_MODULE = "swarmabs_cli"
"""What ``swarm`` runs; this file alone of all frozen tests names it."""

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]
DATA = ROOT / "tests" / "data"
LONGEST = 100.0
"""Time, s, after which a command is taken to hang."""


class Finished(NamedTuple):
    """How a command has ended."""

    code: int
    out: str
    err: str

    def document(self) -> Any:
        """Return the one JSON document that was printed."""
        return json.loads(self.out)


def frozen(name: str) -> dict[str, Any]:
    """Return the frozen data of a file NAME.json."""
    data = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    assert isinstance(data, dict)
    return data


class Terminal(StringIO):
    """What says that it is a terminal, and keeps all that is written to it."""

    encoding = "utf-8"  # type: ignore[assignment]

    def isatty(self) -> bool:
        return True


def swarm(words: Iterable[object], cwd: Path, path: Iterable[Path] = (), columns: int | None = None) -> Finished:
    """Run a command in this process, in a folder, with further folders of packages in the search path.

    It prints into pipes, or to a terminal if that has a width.
    """
    out, err = (StringIO(), StringIO()) if columns is None else (Terminal(), Terminal())
    # To look through all processes for what ROS leaves takes a while, and this one goes on and keeps its files.
    tracing = patch("swarmabs_cli.tracing_files_removed", nullcontext)
    with _place(cwd, tuple(map(str, path)), columns or 120), tracing, redirect_stdout(out), redirect_stderr(err):
        code = main([*map(str, words)])
    return Finished(code, out.getvalue(), err.getvalue())


@contextmanager
def _place(cwd: Path, path: tuple[str, ...], columns: int) -> Iterator[None]:
    """Be in a folder, with further folders in the search path; what is loaded from there is forgotten at the end."""
    before = Path.cwd()
    os.chdir(cwd)
    try:
        with patch.dict(os.environ, COLUMNS=str(columns)), patch.object(sys, "path", [*path, *sys.path]):
            yield
    finally:
        os.chdir(before)
        if path:
            CONTROLLERS.forget()
            for name, module in list(sys.modules.items()):
                if str(getattr(module, "__file__", "")).startswith(path):
                    del sys.modules[name]


def swarm_process(words: Iterable[object], cwd: Path, path: Iterable[Path] = ()) -> Finished:
    """Run a command as users start it, as a process, for those that start processes themselves."""
    search = os.pathsep.join((*map(str, path), os.environ.get("PYTHONPATH", "")))
    done = subprocess.run(
        [sys.executable, "-m", CLI_MODULE, *map(str, words)],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": search, "COLUMNS": "120"},
        capture_output=True,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    return Finished(done.returncode, done.stdout, done.stderr)
