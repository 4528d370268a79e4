"""The bundles of the examples, made once."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.swarmabs_fleet.fleets import EXAMPLES, deployed, example, uses_keys


@pytest.fixture(scope="session")
def examples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Bundles of the examples by name, and beside them `keys`, made where others of a group may write; only read them.

    Their modes are those that are asked for, whatever the mask of the process that makes them.
    """
    folder = tmp_path_factory.mktemp("examples")
    mask = os.umask(0o002)
    try:
        return {
            name: deployed(example(name), folder / name / "out", folder / name / "keys" if uses_keys(name) else None)
            for name in EXAMPLES
        }
    finally:
        os.umask(mask)


@pytest.fixture
def own(examples: dict[str, Path], tmp_path: Path) -> Callable[[str], Path]:
    """Copy an example's bundles and keys for a test that changes them; return the folder of the bundles."""

    def copied(name: str) -> Path:
        shutil.rmtree(tmp_path / "own", ignore_errors=True)
        return shutil.copytree(examples[name].parent, tmp_path / "own" / name) / "out"

    return copied
