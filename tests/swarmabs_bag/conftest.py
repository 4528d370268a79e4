"""A small run and bags of it, with attachments: each kind is made once, and copied by who changes it."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from tests.swarmabs_bag import sample_run

from swarmabs_bag.run_folder import Split
from swarmabs_core.messages import Message

Run: TypeAlias = Sequence[Message]
WriteBag: TypeAlias = Callable[..., Path]

STEPS = 40
STEPS_PER_FILE = 10

SCENARIO = sample_run.SCENARIO.encode()
PROVENANCE = b'{"driver": "lockstep", "versions": {"swarmabs": "1.2.3"}, "arithmetic": 2}'


@pytest.fixture(scope="session")
def run() -> Run:
    return sample_run.make_run(STEPS)


@pytest.fixture(scope="session")
def write_bag(run: Run) -> WriteBag:
    """Return a function that writes the run, or another one, and returns the bag's folder."""

    attachments = {"scenario.yaml": SCENARIO, "provenance.json": PROVENANCE}

    def write(folder: Path, messages: Run = run, **options: Any) -> Path:
        return sample_run.write_bag(folder, messages, attachments, at_end={"run.log": b"all went well\n"}, **options)

    return write


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory, write_bag: WriteBag) -> Path:
    """Return the folder of a complete bag of the run, in several chunks; not to be changed."""
    return write_bag(tmp_path_factory.mktemp("complete") / "bag")


@pytest.fixture(scope="session")
def split_bag(tmp_path_factory: pytest.TempPathFactory, write_bag: WriteBag) -> Path:
    """Return the folder of a complete bag of the run in five files; not to be changed."""
    split = Split(nanoseconds=STEPS_PER_FILE * sample_run.PERIOD)
    return write_bag(tmp_path_factory.mktemp("split") / "bag", chunk_bytes=2000, split=split)


@pytest.fixture
def copy(bag: Path, tmp_path: Path) -> Path:
    """Return a bag's folder that may be damaged."""
    return Path(shutil.copytree(bag, tmp_path / "bag"))


@pytest.fixture
def split(split_bag: Path, tmp_path: Path) -> Path:
    """Return the folder of a bag in five files that may be damaged."""
    return Path(shutil.copytree(split_bag, tmp_path / "split"))
