"""Property tests draw the same examples every time, and take the time they need on a busy machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from swarmabs_core.controllers import ALL_CONTROLLERS
from swarmabs_core.law_registry import ALL_LAWS
from swarmabs_core.realtime.drive_registry import ALL_DRIVES

settings.register_profile("swarmabs", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("swarmabs")


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give a folder in which packages can be installed; what is imported from it is forgotten after the test."""
    folder = tmp_path / "packages"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    for registry in (ALL_CONTROLLERS, ALL_LAWS, ALL_DRIVES):
        for cache in ("_loaded", "_packages"):
            monkeypatch.setattr(registry, cache, {})
    yield folder
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", "")).startswith(str(folder)):
            del sys.modules[name]
