"""The programs in examples/ import their neighbours as scripts do: by the search path."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"
sys.path.insert(0, str(EXAMPLES / "cascade"))


@pytest.fixture
def mujoco_example(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """Import the modules of examples/mujoco, which are given by name; they are forgotten after the test."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: examples/mujoco/README.md says how")
    folder = EXAMPLES / "mujoco"
    monkeypatch.syspath_prepend(folder)
    names = [path.stem for path in folder.glob("*.py") if path.stem != "film"]  # which needs what draws
    yield {name: importlib.import_module(name) for name in names}
    for name in names:
        del sys.modules[name]
