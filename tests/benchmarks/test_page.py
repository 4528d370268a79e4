"""The script that writes a result into docs/performance.md."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks import page
from benchmarks.results import DOCUMENT
from tests.benchmarks.results import document, of_large, repeat
from tests.processes import ROOT

PAGE = "# Page\n\n<!-- bench: speed -->\nold\n<!-- end -->\n\n<!-- bench: memory -->\nkept\n<!-- end -->\n"


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "PAGE", tmp_path / "page.md")
    monkeypatch.setattr(page, "CHART", tmp_path / "chart.svg")
    monkeypatch.setattr(page, "LARGE_CHART", tmp_path / "large.svg")
    (tmp_path / "page.md").write_text(PAGE, encoding="utf-8")


def test_what_was_measured_is_renewed_and_the_rest_stays(tmp_path: Path) -> None:
    (tmp_path / DOCUMENT).write_text(json.dumps(document(repeat(80.0))), encoding="utf-8")
    assert page.main([str(tmp_path)]) == 0
    text = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "| 4 | 80 |" in text
    assert "old" not in text
    assert "kept" in text
    assert (tmp_path / "chart.svg").is_file()


def test_every_suite_has_its_chart(tmp_path: Path) -> None:
    (tmp_path / DOCUMENT).write_text(json.dumps(of_large(8.0)), encoding="utf-8")
    assert page.main([str(tmp_path)]) == 0
    assert (tmp_path / "large.svg").is_file()


def test_without_a_result_the_script_says_how_it_is_used(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert page.main([]) == 2
    assert "python -m benchmarks.page RESULT" in capsys.readouterr().err
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == PAGE


def test_the_page_has_a_place_for_every_table() -> None:
    text = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    for name in (
        "speed",
        "cost",
        "start",
        "memory",
        "large",
        "model",
        "hosts",
        "simulate",
        "recorder",
        "reading",
        "notes",
    ):
        assert text.count(f"<!-- bench: {name} -->") == 1
