"""``swarm report``, as a user types it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_cli import main

pytestmark = pytest.mark.timeout(60)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("report") / "run", "pd_het_4")


def test_files_go_beside_the_bag_and_replace_reports_only(capfd: pytest.CaptureFixture[str], run: Path) -> None:
    assert main(["report", str(run)]) == 0
    assert capfd.readouterr() == (f"{run}/report.html\n{run}/report.png\n", "")
    first = (run / "report.html").read_bytes(), (run / "report.png").read_bytes()
    assert main(["report", str(run / "bag"), "--json"]) == 0
    said = capfd.readouterr()
    document = json.loads(said.out)
    assert document["files"] == [f"{run}/report.html", f"{run}/report.png"]
    assert document["scenario"] == "pd_het_4" and document["status"] == "ok" and document["steps"] == 30
    assert said.err.count("replaced an earlier report") == 2
    assert first == ((run / "report.html").read_bytes(), (run / "report.png").read_bytes())
    (run / "report.html").write_text("mine")
    assert main(["report", str(run)]) == 2
    assert "report.html exists and is no report; name another file" in capfd.readouterr().err
    assert (run / "report.html").read_text() == "mine"
    (run / "report.html").unlink()


def test_named_files_and_folders(capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path) -> None:
    bag = str(run / "bag" / "bag_0.mcap")
    assert main(["report", bag, "--html", str(tmp_path / "one.html")]) == 0
    assert main(["report", bag, "-o", str(tmp_path / "new" / "folder"), "--png", str(tmp_path / "two.png")]) == 0
    found = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert found == ["new/folder/report.html", "one.html", "two.png"]
    capfd.readouterr()
    same = str(tmp_path / "same")
    assert main(["report", bag, "--html", same, "--png", same]) == 2
    assert main(["report", bag, "-o", str(tmp_path / "one.html")]) == 2
    assert "is no folder" in capfd.readouterr().err


@pytest.mark.parametrize("name", ["missing", "folder", "text.mcap"])
def test_what_is_no_bag_leaves_nothing(capfd: pytest.CaptureFixture[str], tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.mcap").write_text("no bag")
    before = sorted(tmp_path.rglob("*"))
    assert main(["report", str(tmp_path / name)]) == 2
    said = capfd.readouterr()
    assert said.out == "" and said.err.startswith("error: ") and said.err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before
