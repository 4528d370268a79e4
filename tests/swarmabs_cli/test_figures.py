"""``swarm figures`` and ``swarm report``, as a user types them."""

import json
from pathlib import Path
from typing import Any

import pytest
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_analysis.report.conftest import messages, write
from tests.swarmabs_cli.conftest import document, ran, refused

PD = ("pd_si_4", "pd_di_4", "pd_het_4")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Have no figure drawn, which others test; return the runs that each would have shown, by its name."""
    found: dict[str, Any] = {}

    def draw(name: str, sources: dict[str, Any], formats: tuple[str, ...]) -> dict[str, bytes]:
        found[name] = sources
        return {f"{name}.{kind}": b"swarmabs" for kind in formats}

    monkeypatch.setattr("swarmabs_cli.study.figures.draw_files", draw)
    return found


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


@pytest.mark.system
def test_missing_runs_are_simulated_and_used_again(here: Path, drawn: dict[str, Any]) -> None:
    first = ran("figures", "PD_res", "-o", "out", "--format", "svg", "--json")
    assert first.document() == {
        "files": ["out/PD_res.svg"],
        "made": list(PD),
        "bags": {name: f"out/runs/{name}/bag/bag_0.mcap" for name in PD},
    }
    assert "pd_het_4: step 3000 of 3000" in first.err and "drawing PD_res" in first.err and "warning" not in first.err
    digest = document("simulate", "pd_het_4", "-o", "again", "--no-bag")["digest"]
    assert json.loads((here / "out/runs/pd_het_4/summary.json").read_text())["digest"] == digest
    second = document("figures", "PD_res", "-o", "out")
    assert (second["made"], second["files"]) == ([], ["out/PD_res.png", "out/PD_res.svg"])
    assert {name: source.altered for name, source in drawn["PD_res"].items()} == dict.fromkeys(PD, False)


def test_bags_are_drawn_and_a_missing_one_is_made_only_when_asked(here: Path, drawn: dict[str, Any]) -> None:
    for name in PD[:2]:
        record(here / "runs" / name, name)
    error = refused("figures", "PD_res", "--from", "runs", "-o", "out")
    assert "--from has no bag of pd_het_4 (for PD_res); add it" in error
    error = refused("figures", "--from", "runs", "-o", "out")
    assert all(f"{name} (for ARISE_lg_swarm)" in error for name in ("arise_het_20", "arise_het_200"))
    done = ran("figures", "PD_res", "--from", "runs", "--simulate", "-o", "out", "--format", "png", "--json")
    found = done.document()
    assert (found["made"], found["bags"]["pd_si_4"]) == (["pd_het_4"], "runs/pd_si_4/bag/bag_0.mcap")
    assert "warning: runs/pd_si_4/bag/bag_0.mcap is a variant of the built-in pd_si_4" in done.err
    assert [name for name in names(here / "out") if "/" not in name] == ["PD_res.png"]


def test_without_runs_only_geometry_is_drawn_and_what_cannot_be_drawn_or_written_is_refused(here: Path) -> None:
    assert ran("figures", "posMapping", "--format", "png").out == "figures/posMapping.png\n"
    assert names(here) == ["figures/posMapping.png"]
    error = refused("figures", "PD", "--json")
    assert "unknown figure 'PD'; choose from mappingEx, posMapping, PD_res, ARISE_res, ARISE_lg_swarm" in error
    (here / "out").write_text("a file")
    assert "error: out cannot be created: " in refused("figures", "posMapping", "-o", "out")
    assert "error: out/below/runs cannot be created: " in refused("figures", "PD_res", "-o", "out/below")


def test_a_damaged_bag_stops_it_before_any_file_is_written(here: Path) -> None:
    for name in PD:
        record(here / "runs" / name, name)
    bag = here / "runs/pd_het_4/bag/bag_0.mcap"
    content = bytearray(bag.read_bytes())
    content[len(content) // 3] ^= 0xFF
    bag.write_bytes(content)
    done = ran("figures", "PD_res", "--from", "runs", "-o", "out", code=1)
    assert "error: runs/pd_het_4/bag/bag_0.mcap: " in done.err
    assert names(here / "out") == []


@pytest.fixture
def bag(here: Path) -> Path:
    """Return a bag in which nothing is to be drawn."""
    write(here / "run" / "bag", messages(0)[:7], aborted="interrupted")
    return Path("run/bag/bag_0.mcap")


def test_files_go_beside_the_bag_and_replace_reports_only(bag: Path) -> None:
    page, overview = Path("run/report.html"), Path("run/report.png")
    done = ran("report", "run")
    assert (done.out, done.err) == ("run/report.html\nrun/report.png\n", "")
    first = page.read_bytes(), overview.read_bytes()
    again = ran("report", "run/bag", "--json")
    found = again.document()
    assert (found["files"], found["bag"]) == ([str(page), str(overview)], "run/bag/bag_0.mcap")
    assert (found["scenario"], found["status"], found["steps"]) == ("sample", "interrupted", 0)
    assert again.err.count("replaced an earlier report") == 2
    assert (page.read_bytes(), overview.read_bytes()) == first
    page.write_text("mine")
    assert "report.html exists and is not a report; name another file" in refused("report", "run")


def test_named_files_and_folders(here: Path, bag: Path) -> None:
    before = names(here)
    ran("report", bag, "--html", "one.html")
    ran("report", bag, "-o", "new/folder", "--png", "two.png")
    assert names(here) == sorted([*before, "new/folder/report.html", "one.html", "two.png"])
    assert "both name same" in refused("report", bag, "--html", "same", "--png", "same")
    assert "is not a folder" in refused("report", bag, "-o", "one.html")


@pytest.mark.system
@pytest.mark.full
@pytest.mark.timeout(240)
def test_runs_of_real_processes_give_the_same_files(here: Path, nothing_survives: str) -> None:
    ran("figures", "PD_res", "-o", "simulated")
    ran("figures", "PD_res", "--run", "-o", "real")
    for kind in ("png", "svg"):
        assert (here / f"real/PD_res.{kind}").read_bytes() == (here / f"simulated/PD_res.{kind}").read_bytes()
    assert (here / "real/runs/pd_het_4/logs/network.json").exists()
