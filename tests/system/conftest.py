"""System tests: real processes that talk over DDS, and real bags. None of them may leave anything behind."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.processes import SEARCH_PATH


@pytest.fixture(autouse=True)
def mark(nothing_survives: str) -> str:
    """Return the mark that all processes of the test carry in their environment."""
    return nothing_survives


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return the folder of a run, which does not exist yet."""
    return tmp_path / "run"


@pytest.fixture
def own_modules(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let a run's processes import the modules of these tests."""
    monkeypatch.setenv("PYTHONPATH", SEARCH_PATH["PYTHONPATH"])
    yield
    assert os.environ["PYTHONPATH"] == SEARCH_PATH["PYTHONPATH"]
