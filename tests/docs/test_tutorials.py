"""The tutorials, followed to the letter in an empty folder."""

import os
import re
import subprocess
import sys
from math import sin
from pathlib import Path
from typing import Any

import pytest
from scipy.integrate import solve_ivp
from tests.docs.pages import ROOT, blocks, read, script

from swarmabs_bag.arrays import load_arrays

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]
FIRST = "docs/tutorials/first_controller.md"
FERRY = "docs/tutorials/parent_system.md"
GAINS = "docs/tutorials/gain_study.ipynb"


def follow(page: str, folder: Path) -> None:
    """Write the files of a page into a folder and run its commands there."""
    scripts = folder / "scripts"
    scripts.mkdir()
    (scripts / "swarm").write_text(f'#!/bin/sh\nexec {sys.executable} -m swarmabs_cli "$@"\n', encoding="utf-8")
    (scripts / "swarm").chmod(0o755)
    text = read(page)
    for name, content in re.findall(r"`(\w+/[\w.]+)`:\n\n```\w+\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(content, encoding="utf-8")
    commands = "".join(blocks(text, "sh"))
    installed = str(folder / "installed")  # stands for the environment, which other tests share
    search = f"{installed}:{os.environ.get('PYTHONPATH', '')}"
    environment = {**os.environ, "PIP_TARGET": installed, "PYTHONPATH": search, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    script = re.sub(r"^mkdir \w+$", "", commands, flags=re.MULTILINE)
    ended = subprocess.run(
        ["bash", "-ec", script], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr


def picture_of(page: str, folder: Path) -> None:
    """The script of the pictures draws a page's picture from the followed tutorial."""
    target = folder / "pictures"
    target.mkdir()
    assert script("docs/figures/tutorials.py").draw(folder, target) == [page]
    assert (target / f"{page}.png").read_bytes()[:4] == b"\x89PNG"


def test_first_controller(nothing_survives: str, tmp_path: Path) -> None:
    follow(FIRST, tmp_path)
    assert abs(load_arrays(tmp_path / "mine" / "pd").angle[-1]) == pytest.approx(0.092, abs=0.001)
    assert abs(load_arrays(tmp_path / "mine" / "pid").angle[-1]) < 0.01
    assert (tmp_path / "mine" / "comparison.png").read_bytes()[:4] == b"\x89PNG"
    assert (tmp_path / "mine" / "pid" / "report.html").is_file()
    picture_of("first_controller", tmp_path)


def test_parent_system(nothing_survives: str, tmp_path: Path) -> None:
    """The trolleys hold the ferry as the page says; the oracle solves its equation of motion with the wanted moment."""
    follow(FERRY, tmp_path)
    folder = tmp_path / "ferry"
    assert len((folder / "ferry.py").read_text(encoding="utf-8").splitlines()) <= 150
    assert (folder / "roll.png").read_bytes()[:4] == b"\x89PNG"
    picture_of("parent_system", tmp_path)
    run, passive, gust = (load_arrays(folder / name) for name in ("run", "passive", "gust"))

    def motion(time: float, state: list[float], gain: float) -> list[float]:
        roll, rate = state
        wanted = gain * rate
        inertia = 4e4 + 1e-5 * wanted * wanted + 100.0
        return [rate, (-wanted - 5e4 * roll - 5.4e3 * rate - 3000.0 * sin(0.94 * time)) / inertia]

    late = run.time >= 10.0
    for arrays, gain, most in ((run, 8e4, 0.04), (passive, 0.0, 0.28)):
        ideal = solve_ivp(motion, (0.0, 30.0), [0.15, 0.0], t_eval=arrays.time, args=(gain,), rtol=1e-8).y[0]
        assert abs(arrays["roll"] - ideal)[late].max() < 0.1 * most
        assert 0.9 * most < abs(arrays["roll"])[late].max() < most
    assert "left" in {event.kind for event in gust.events}
    moved = abs(gust["roll"] - run["roll"])
    assert moved[run.time <= 10.0].max() == 0.0
    assert moved[run.time >= 15.0].max() > 0.02


def test_gain_study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """What it prints is what its stored outputs say; pictures are not compared."""
    import nbformat  # noqa: PLC0415 - no other test needs Jupyter
    from nbclient import NotebookClient  # noqa: PLC0415

    monkeypatch.setenv("TMPDIR", str(tmp_path))  # of the kernel, which leaves a folder there
    notebook = nbformat.read(ROOT / GAINS, as_version=4)
    stored = printed(notebook)
    NotebookClient(notebook, timeout=60, kernel_name="python3").execute()
    assert printed(notebook) == stored
    assert list(tmp_path.rglob("gain-10"))
    assert any("equal to the simulation: True" in text for text in stored)


def printed(notebook: Any) -> list[str]:
    return [output.text for cell in notebook.cells for output in cell.get("outputs", ()) if "text" in output]
