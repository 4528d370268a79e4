"""The command as users start it, and the frozen data beside this file."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

CLI_MODULE = "swarmabs_cli"
"""What ``swarm`` runs; this file alone of all frozen tests names it."""

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]
DATA = ROOT / "tests" / "data"
PLUGIN = ROOT / "examples" / "sliding_mode"
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


def swarm(words: Iterable[object], cwd: Path, path: Iterable[Path] = ()) -> Finished:
    """Run a command to its end in a folder, with further folders of packages in the search path."""
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


def plugin_folder(folder: Path) -> Path:
    """Install the example of a parent controller as an installer does: its module, and its metadata beside it."""
    name = "swarmabs_sliding_mode"
    metadata = folder / f"{name}-1.0.0.dist-info"
    metadata.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.py").write_bytes((PLUGIN / f"{name}.py").read_bytes())
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: swarmabs-sliding-mode\nVersion: 1.0.0\n")
    (metadata / "entry_points.txt").write_text(
        f"[swarmabs.parent_controllers]\nsliding_mode = {name}:SLIDING_MODE\n", encoding="utf-8"
    )
    return folder
