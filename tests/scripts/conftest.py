"""The set-up's modules, and a checkout in which to try them."""

from __future__ import annotations

import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from _setup.checkout import Checkout  # noqa: E402


@pytest.fixture(scope="session")
def swarm() -> ModuleType:
    """The script, which has no suffix, as a module."""
    loader = SourceFileLoader("swarm_script", str(ROOT / "scripts" / "swarm"))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    """A checkout with two Python packages, one message package, and locks, nothing of it prepared."""
    made = Checkout(str(tmp_path))
    for name in ("alpha", "beta", "gamma_msgs"):
        folder = tmp_path / "src" / name
        folder.mkdir(parents=True)
        (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
        (folder / "code.py").write_text("VALUE = 1\n")
    (tmp_path / "src" / "gamma_msgs" / "CMakeLists.txt").write_text("project(gamma_msgs)\n")
    locks = tmp_path / "scripts" / "requirements"
    locks.mkdir(parents=True)
    for name in ("run", "build", "sweep", "bench", "deploy", "view", "foxglove", "test"):
        entry = f"{name}-part==1.0 \\\n    --hash=sha256:00\nsetuptools==79.0.1 \\\n    --hash=sha256:11\n"
        (locks / f"{name}.lock").write_text(entry)
    return made
