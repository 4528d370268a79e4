"""``swarm figures``, as a user types it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_cli import main

pytestmark = pytest.mark.timeout(60)
PD = ("pd_si_4", "pd_di_4", "pd_het_4")


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def figures(capfd: pytest.CaptureFixture[str], *words: str, code: int = 0) -> tuple[Any, str]:
    """Run the command, and return the one JSON document and what went to standard error."""
    assert main(["figures", *words, "--json"]) == code
    captured = capfd.readouterr()
    return json.loads(captured.out) if code == 0 else captured.out, captured.err


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_missing_runs_are_simulated_and_used_again(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    first, shown = figures(capfd, "PD_res", "-o", "out", "--format", "svg")
    assert first["files"] == ["out/PD_res.svg"]
    assert first["made"] == list(PD)
    assert first["bags"] == {name: f"out/runs/{name}/bag/bag_0.mcap" for name in PD}
    assert "pd_het_4: step 3000 of 3000" in shown and "drawing PD_res" in shown and "warning" not in shown
    assert main(["simulate", "pd_het_4", "-o", "again", "--no-bag", "--json"]) == 0
    digest = json.loads(capfd.readouterr().out)["digest"]
    assert json.loads((here / "out/runs/pd_het_4/summary.json").read_text())["digest"] == digest
    content = (here / "out/PD_res.svg").read_bytes()
    second, _ = figures(capfd, "PD_res", "-o", "out")
    assert second["made"] == []
    assert second["files"] == ["out/PD_res.png", "out/PD_res.svg"]
    assert (here / "out/PD_res.svg").read_bytes() == content


def test_bags_are_drawn_and_a_missing_one_is_made_only_when_asked(
    capfd: pytest.CaptureFixture[str], here: Path
) -> None:
    for name in PD[:2]:
        record(here / "runs" / name, name)
    out, shown = figures(capfd, "PD_res", "--from", "runs", "-o", "out", code=2)
    assert out == ""
    assert shown.startswith("error: --from has no bag of pd_het_4 (for PD_res); add it")
    assert not (here / "out").exists()
    _, shown = figures(capfd, "--from", "runs", "-o", "out", code=2)
    assert all(f"{name} (for ARISE_lg_swarm)" in shown for name in ("arise_het_20", "arise_het_200"))
    assert not (here / "out").exists()
    found, shown = figures(capfd, "PD_res", "--from", "runs", "--simulate", "-o", "out", "--format", "png")
    assert found["made"] == ["pd_het_4"]
    assert found["bags"]["pd_si_4"] == "runs/pd_si_4/bag/bag_0.mcap"
    assert "warning: runs/pd_si_4/bag/bag_0.mcap: not the built-in pd_si_4, but a variant" in shown
    assert [name for name in names(here / "out") if "/" not in name] == ["PD_res.png"]


def test_without_runs_only_geometry_is_drawn(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    found, _ = figures(capfd, "posMapping", "mappingEx", "--format", "png")
    assert found == {"files": ["figures/mappingEx.png", "figures/posMapping.png"], "bags": {}, "made": []}
    assert names(here) == ["figures/mappingEx.png", "figures/posMapping.png"]


def test_unknown_figures_are_refused(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    _, shown = figures(capfd, "PD", code=2)
    assert "no figure 'PD'; there are mappingEx, posMapping, PD_res, ARISE_res, ARISE_lg_swarm" in shown
    assert list(here.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_refused(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    (here / "out").write_text("a file")
    _, shown = figures(capfd, "posMapping", "-o", "out", code=2)
    assert "error: out cannot be made: " in shown
    _, shown = figures(capfd, "PD_res", "-o", "out/below", code=2)
    assert "error: out/below/runs cannot be made: " in shown


def test_a_damaged_bag_stops_it_before_any_file_is_written(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    for name in PD:
        record(here / "runs" / name, name)
    bag = here / "runs/pd_het_4/bag/bag_0.mcap"
    content = bytearray(bag.read_bytes())
    content[len(content) // 3] ^= 0xFF
    bag.write_bytes(content)
    _, shown = figures(capfd, "posMapping", "PD_res", "--from", "runs", "-o", "out", code=1)
    assert "error: runs/pd_het_4/bag/bag_0.mcap: " in shown
    assert names(here / "out") == []


@pytest.mark.system
@pytest.mark.full
@pytest.mark.timeout(240)
def test_runs_of_real_processes_give_the_same_files(
    capfd: pytest.CaptureFixture[str], here: Path, nothing_survives: str
) -> None:
    figures(capfd, "PD_res", "-o", "simulated")
    figures(capfd, "PD_res", "--run", "-o", "real")
    for kind in ("png", "svg"):
        assert (here / f"real/PD_res.{kind}").read_bytes() == (here / f"simulated/PD_res.{kind}").read_bytes()
    assert (here / "real/runs/pd_het_4/logs/network.json").exists()
