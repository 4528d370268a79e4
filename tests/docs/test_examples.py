"""Examples in the documentation and in examples/ work."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from tests.docs.pages import ROOT, blocks, read, section

from swarmabs_config.scenario import load_scenario, parse_scenario
from swarmabs_run.simulation import simulate

SCENARIOS = sorted((ROOT / "examples").glob("*.yaml"))
PROGRAMS = sorted((ROOT / "examples").glob("*.py"))


def test_scenario_of_the_readme_loads_and_levels_the_plane() -> None:
    (text,) = blocks(section(read("README.md"), "Write a scenario"), "yaml")
    scenario = parse_scenario(text)
    run = simulate(scenario)
    assert abs(run.angle[-1]) < 0.01 < abs(run.angle[0])


def run_python(*arguments: str, cwd: Path) -> str:
    process = subprocess.run(
        [sys.executable, "-W", "error", *arguments], cwd=cwd, capture_output=True, text=True, check=False, timeout=60
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


@pytest.mark.timeout(60)
def test_python_of_the_readme_runs(tmp_path: Path) -> None:
    (text,) = blocks(section(read("README.md"), "How it works"), "python")
    assert "[1 2 3 4]" in run_python("-c", text, cwd=tmp_path)


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.name)
def test_example_scenarios_run(path: Path) -> None:
    scenario = load_scenario(path)
    run = simulate(scenario)
    assert run.step[-1] == scenario.steps
    assert abs(run.angle[-1]) < 0.01


@pytest.mark.timeout(60)
@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_example_programs_run(path: Path, tmp_path: Path) -> None:
    assert run_python(str(path), cwd=tmp_path)


def test_there_are_examples() -> None:
    assert SCENARIOS
    assert PROGRAMS


def test_python_of_the_pages_compiles() -> None:
    for name in ("README.md", "docs/ros.md"):
        for text in blocks(read(name), "python"):
            compile(text, name, "exec")
