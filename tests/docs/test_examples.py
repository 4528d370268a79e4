"""Examples in the documentation and in examples/ work, and the scripts of the pictures."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
from tests.docs.pages import NAMES, ROOT, blocks, read, section
from tests.plugin_packages import install
from tests.swarmabs_analysis.figures.conftest import NAMES as SCENARIOS_OF_THE_PAPER, record
from tests.swarmabs_view.conftest import chromium

from swarmabs_analysis.figures import FIGURES
from swarmabs_analysis.sweep.study import load_sweep
from swarmabs_config.scenario import load_scenario, parse_scenario
from swarmabs_run.simulation import simulate

SCENARIOS = {path.name: load_scenario(path) for path in sorted((ROOT / "examples").glob("*.yaml"))}
PROGRAMS = sorted({path.name for path in (ROOT / "examples").glob("*.py")} - {"reference_tools.py"})
(README,) = blocks(section(read("README.md"), "Write a scenario"), "yaml")


@pytest.mark.parametrize("name", ["README.md", *SCENARIOS])
@pytest.mark.system
def test_example_scenarios_level_the_plane(name: str) -> None:
    scenario = SCENARIOS.get(name) or parse_scenario(README)
    run = simulate(scenario)
    assert run.step[-1] == scenario.steps
    assert abs(run.angle[-1]) < 0.01 < abs(run.angle[0])


def test_the_sweeps_of_the_page_and_of_the_examples_are_valid(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(blocks(read("docs/how-to/sweep.md"), "yaml")[0])
    assert load_sweep(tmp_path / "s.yaml").sweep.count == 9 * 2 * 20
    for path in (ROOT / "examples" / "sweeps").glob("*.yaml"):
        assert load_sweep(path).sweep.count > 1


@pytest.mark.parametrize("path", ["README.md", *PROGRAMS])
def test_python_of_the_readme_and_example_programs_run(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if path == "README.md":
        (text,) = blocks(section(read(path), "Use it from Python"), "python")
        program = tmp_path / "readme.py"
        program.write_text(text, encoding="utf-8")
    else:
        program = ROOT / "examples" / path
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(program), run_name="__main__")
    out = capsys.readouterr().out
    if path == "README.md":
        (shown,) = re.findall(r"(?ms)^<!-- output of the example -->\n```text\n(.*?)^```$", read(path))
        assert out == shown
    assert out


def test_python_of_the_pages_compiles() -> None:
    found = [(name, text) for name in NAMES for text in blocks(read(name), "python")]
    assert len(found) > 2
    for name, text in found:
        compile(text, name, "exec")


def test_the_law_of_the_page_bounds_the_commands(packages: Path) -> None:
    text = section(read("docs/how-to/extending.md"), "A swarm law")
    (source,) = blocks(text, "python")
    (selection,) = blocks(text, "yaml")
    install(packages, "law", "bounded", source, target="test_bounded:BOUNDED")
    robots = "  generate: {double_integrator: 3, single_integrator: 4}\n"
    scenario = f"schema: 1\nduration: 3\nplane: {{angle: 0.3}}\n{selection}{robots}"
    bounded = simulate(parse_scenario(scenario, overrides=["swarm.law.bound=0.2"]))
    paper = simulate(parse_scenario(scenario, overrides=["swarm.law.type=paper"]))
    assert abs(bounded.agents.command).max() <= 0.2 < abs(paper.agents.command).max()
    assert abs(bounded.angle[-1]) < 0.5 * bounded.angle[0]


def draw(script: str, *arguments: Path, within: float = 50.0) -> None:
    command = [sys.executable, ROOT / "docs" / script, *arguments]
    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=within)
    assert process.returncode == 0, process.stderr


@pytest.mark.system
def test_pictures_of_a_run_and_of_the_architecture(tmp_path: Path) -> None:
    draw("figures/run.py", record(tmp_path / "run", "pd_het_4", "duration=9.0"), tmp_path / "run.png")
    assert (tmp_path / "run.png").read_bytes()[:4] == b"\x89PNG"
    draw("figures/gallery.py", tmp_path / "run", tmp_path / "gallery.png")
    assert (tmp_path / "gallery.png").read_bytes()[:4] == b"\x89PNG"
    draw("figures/architecture.py", tmp_path / "architecture.svg")
    assert "<svg" in (tmp_path / "architecture.svg").read_text(encoding="utf-8")


@pytest.mark.system
def test_pictures_of_the_paper(tmp_path: Path) -> None:
    for name in SCENARIOS_OF_THE_PAPER:
        record(tmp_path / "runs" / name, name)
    draw("figures/paper.py", tmp_path / "runs", tmp_path)
    for name in FIGURES:
        assert (tmp_path / f"{name}.png").read_bytes()[:4] == b"\x89PNG"
        assert (ROOT / "docs" / "images" / f"{name}.png").stat().st_size < 200_000
        assert f"## {name}\n" in (ROOT / "docs" / "how-to" / "figures.md").read_text(encoding="utf-8")


@pytest.mark.system
@pytest.mark.full
@pytest.mark.timeout(200)
def test_pictures_of_the_view(tmp_path: Path) -> None:
    chromium()
    draw("screenshots.py", tmp_path, within=180.0)
    kept = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert set(kept) == {path.name for path in (ROOT / "docs" / "images").glob("view*.webp")}
    assert all(5_000 < size < 300_000 for size in kept.values())
