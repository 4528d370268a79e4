"""The scripts of the pictures work."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from tests.docs.pages import ROOT
from tests.swarmabs_view.conftest import chromium

from swarmabs_analysis.figures import FIGURES
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulated_run import simulate_run

SCRIPTS = ROOT / "docs" / "figures"


def draw(script: str, *arguments: Path) -> None:
    command = [sys.executable, SCRIPTS / script, *arguments]
    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=50)
    assert process.returncode == 0, process.stderr


@pytest.mark.timeout(60)
def test_picture_of_a_run(tmp_path: Path) -> None:
    folder = new_run_folder(tmp_path / "run")
    simulate_run(find_scenario("pd_het_4", ["duration=9.0"]).resolved(), folder)
    draw("run.py", folder.path, tmp_path / "run.png")
    assert (tmp_path / "run.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.timeout(60)
def test_picture_of_the_architecture(tmp_path: Path) -> None:
    draw("architecture.py", tmp_path / "architecture.svg")
    assert "<svg" in (tmp_path / "architecture.svg").read_text(encoding="utf-8")


def test_pictures_are_there() -> None:
    views = ("view.webp", "view_dark.webp", "view_live.webp", "view_phone.webp")
    for name in ("run.png", "architecture.svg", "parent_response.png", *views):
        assert (ROOT / "docs" / "images" / name).is_file()


@pytest.mark.timeout(60)
def test_pictures_of_the_paper(tmp_path: Path) -> None:
    for name in (scenario for figure in FIGURES.values() for scenario in figure.scenarios):
        simulate_run(find_scenario(name, ["duration=0.2"]).resolved(), new_run_folder(tmp_path / "runs" / name))
    draw("paper.py", tmp_path / "runs", tmp_path)
    for name in FIGURES:
        assert (tmp_path / f"{name}.png").read_bytes()[:4] == b"\x89PNG"
        assert (ROOT / "docs" / "images" / f"{name}.png").stat().st_size < 200_000
        assert f"## {name}\n" in (ROOT / "docs" / "figures.md").read_text(encoding="utf-8")


@pytest.mark.full
@pytest.mark.timeout(200)
def test_pictures_of_the_view(tmp_path: Path) -> None:
    chromium()
    command = [sys.executable, ROOT / "docs" / "screenshots.py", tmp_path]
    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=180)
    assert process.returncode == 0, process.stderr
    kept = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert set(kept) == {path.name for path in (ROOT / "docs" / "images").glob("view*.webp")}
    assert all(5_000 < size < 300_000 for size in kept.values())
