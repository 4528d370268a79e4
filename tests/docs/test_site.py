"""The site of HTML pages: complete, and refused with a fault in it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.docs.pages import NAMES, ROOT

from swarmabs_cli import main

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]


def test_site_has_every_page_and_every_package(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    site = tmp_path / "site"
    assert main(["docs", "-o", str(site)]) == 0, capfd.readouterr().err
    pages = {name.removesuffix(".md").replace("README", "index") for name in NAMES}
    packages = {f"docs/python/{path.parent.name}" for path in ROOT.glob("src/*/*/__init__.py")}
    assert {name for name in pages | packages if not (site / f"{name}.html").is_file()} == set()
    assert "<math" in (site / "docs" / "explanation" / "equations.html").read_text(encoding="utf-8")
    assert "swarmabs_run.simulation.simulate" in (site / "docs" / "python" / "swarmabs_run.html").read_text()


@pytest.mark.parametrize("fault", ["[gone](gone.md)", "[gone](../README.md#gone)", r"$\gone{x}$"])
def test_faults_are_refused(fault: str, tmp_path: Path) -> None:
    copy = tmp_path / "checkout"
    shutil.copytree(ROOT / "docs", copy / "docs")
    shutil.copytree(ROOT / "examples", copy / "examples")
    for path in ROOT.glob("*.md"):
        shutil.copy(path, copy)
    page = copy / "docs" / "how-to" / "bags.md"
    page.write_text(f"{page.read_text(encoding='utf-8')}\n{fault}\n", encoding="utf-8")
    command = [sys.executable, "-m", "docs.build_site", str(tmp_path / "site")]
    environment = {**os.environ, "PYTHONPATH": f"{copy}:{os.environ.get('PYTHONPATH', '')}", "NO_MKDOCS_2_WARNING": "1"}
    ended = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert "gone" in ended.stderr


def test_a_folder_that_holds_something_else_is_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.txt").write_text("keep", encoding="utf-8")
    assert main(["docs", "-o", str(tmp_path)]) == 2
    (tmp_path / "file").touch()
    assert main(["docs", "-o", str(tmp_path / "file" / "site")]) == 2
    assert "not built by this command" in capfd.readouterr().err
    assert (tmp_path / "mine.txt").is_file()
