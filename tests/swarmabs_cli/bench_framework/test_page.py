"""The script that writes a result into docs/performance.md."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest
from tests.processes import ROOT
from tests.swarmabs_cli.bench_framework.results import document, of_large, repeat

from swarmabs_cli.bench_framework.results import DOCUMENT

PAGE = "# Page\n\n<!-- bench: speed -->\nold\n<!-- end -->\n\n<!-- bench: memory -->\nkept\n<!-- end -->\n"


@pytest.fixture
def script(tmp_path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("bench_page", ROOT / "docs" / "bench.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.PAGE = tmp_path / "page.md"  # type: ignore[attr-defined]
    module.CHART, module.LARGE_CHART = tmp_path / "chart.svg", tmp_path / "large.svg"  # type: ignore[attr-defined]
    (tmp_path / "page.md").write_text(PAGE, encoding="utf-8")
    return module


def test_what_was_measured_is_renewed_and_the_rest_stays(script: ModuleType, tmp_path: Path) -> None:
    (tmp_path / DOCUMENT).write_text(json.dumps(document(repeat(80.0))), encoding="utf-8")
    assert script.main([str(tmp_path)]) == 0
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "| 4 | 80 |" in page
    assert "old" not in page
    assert "kept" in page
    assert (tmp_path / "chart.svg").is_file()


def test_every_suite_has_its_chart(script: ModuleType, tmp_path: Path) -> None:
    (tmp_path / DOCUMENT).write_text(json.dumps(of_large(8.0)), encoding="utf-8")
    assert script.main([str(tmp_path)]) == 0
    assert (tmp_path / "large.svg").is_file()


def test_without_a_result_the_script_says_how_it_is_used(
    script: ModuleType, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert script.main([]) == 2
    assert "python docs/bench.py RESULT" in capsys.readouterr().err
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == PAGE


def test_the_page_has_a_place_for_every_table() -> None:
    page = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
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
        assert page.count(f"<!-- bench: {name} -->") == 1
