"""Whether two processes compute with the same swarmabs."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from swarmabs_analysis.sweep import executor as module
from swarmabs_analysis.sweep.executor import Identity, identity, stranger

MINE = Identity("0.1.0", "aaaa", "cccc")


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Let the identity be that of a copy of the sources."""
    for name, folder in module._SOURCES.items():
        shutil.copytree(folder, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(module, "_SOURCES", {name: tmp_path / name for name in module._SOURCES})
    return tmp_path


def test_the_same_sources_elsewhere_are_the_same(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = identity()
    monkeypatch.undo()
    assert found == identity()


@pytest.mark.parametrize("name", ["swarmabs_core/plant.py", "swarmabs_core/controllers.py", "sweep/evaluate.py"])
def test_any_changed_source_is_another(copy: Path, name: str) -> None:
    before = identity()
    path = copy / name
    path.write_bytes(path.read_bytes() + b"\n")
    assert identity().sources != before.sources
    assert identity().version == before.version


def test_a_source_under_another_name_is_another(copy: Path) -> None:
    before = identity()
    (copy / "sweep" / "evaluate.py").rename(copy / "sweep" / "evaluated.py")
    assert identity().sources != before.sources


@pytest.mark.parametrize(
    ("theirs", "words"),
    [
        (MINE._replace(version="0.0.9"), "worker tcp://b:2 has swarmabs 0.0.9, sources aaaa, and this is 0.1.0"),
        (MINE._replace(sources="bbbb"), "worker tcp://b:2 has swarmabs 0.1.0, sources bbbb, and this is 0.1.0"),
    ],
)
def test_another_version_or_other_sources_are_named_with_the_worker(theirs: Identity, words: str) -> None:
    assert words in (stranger(MINE, {"tcp://a:1": MINE, "tcp://b:2": theirs}) or "")


def test_another_mathematical_library_is_no_other_swarmabs() -> None:
    assert stranger(MINE, {"tcp://a:1": MINE._replace(libm="dddd")}) is None
