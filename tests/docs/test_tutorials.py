"""The tutorials, followed to the letter in an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.docs.pages import ROOT, blocks, read

from swarmabs_bag.arrays import load_arrays

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]
FIRST = "docs/tutorials/first_controller.md"
GAINS = "docs/tutorials/gain_study.ipynb"


def test_first_controller(nothing_survives: str, tmp_path: Path) -> None:
    scripts = tmp_path / "scripts"
    scripts.mkdir()
    (scripts / "swarm").write_text(f'#!/bin/sh\nexec {sys.executable} -m swarmabs_cli "$@"\n', encoding="utf-8")
    (scripts / "swarm").chmod(0o755)
    (tmp_path / "mine").mkdir()
    page = read(FIRST)
    for name, text in re.findall(r"`(mine/[\w.]+)`:\n\n```\w+\n(.*?)^```", page, re.MULTILINE | re.DOTALL):
        (tmp_path / name).write_text(text, encoding="utf-8")
    commands = "".join(blocks(page, "sh")).splitlines()
    assert commands[:2] == ["git clone <this repository> swarmabs", "cd swarmabs"]
    script = "\n".join(line for line in commands[2:] if line != "mkdir mine")
    installed = str(tmp_path / "installed")  # stands for the environment, which other tests share
    search = f"{installed}:{os.environ.get('PYTHONPATH', '')}"
    environment = {**os.environ, "PIP_TARGET": installed, "PYTHONPATH": search, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    ended = subprocess.run(
        ["bash", "-ec", script], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert abs(load_arrays(tmp_path / "mine" / "pd").angle[-1]) == pytest.approx(0.092, abs=0.001)
    assert abs(load_arrays(tmp_path / "mine" / "pid").angle[-1]) < 0.01
    assert (tmp_path / "mine" / "comparison.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "mine" / "pid" / "report.html").is_file()


def test_gain_study() -> None:
    """What it prints is what its stored outputs say; pictures are not compared."""
    import nbformat  # noqa: PLC0415 - no other test needs Jupyter
    from nbclient import NotebookClient  # noqa: PLC0415

    notebook = nbformat.read(ROOT / GAINS, as_version=4)
    stored = printed(notebook)
    NotebookClient(notebook, timeout=60, kernel_name="python3").execute()
    assert printed(notebook) == stored
    assert any("equal to the simulation: True" in text for text in stored)


def printed(notebook: Any) -> list[str]:
    return [output.text for cell in notebook.cells for output in cell.get("outputs", ()) if "text" in output]
