"""Damaged bags of all kinds: no traceback, no wrong content, no hang and no more memory than there should be."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def wrong_answers(what: str, folder: Path, first: int, number: int) -> str:
    """Return what the fuzzer says of a range of seeds, without its last line if all answers are right."""
    found = subprocess.run(
        [sys.executable, "-m", "tests.swarmabs_bag.fuzz", what, str(folder), str(first), str(number)],
        capture_output=True,
        text=True,
        check=False,
        cwd=FOLDER,
        env=ENVIRONMENT,
    )
    last = f"{what}: {number} damages from seed {first} on, 0 wrong answers, "
    said = found.stdout + found.stderr
    return "" if found.returncode == 0 and said.startswith(last) and said.count("\n") == 1 else said


@pytest.mark.timeout(600)
@pytest.mark.parametrize(("what", "number"), [("reading", 40), ("commands", 6), ("repair", 20), ("split", 6)])
def test_no_damage_has_a_wrong_answer(what: str, number: int, tmp_path: Path) -> None:
    assert wrong_answers(what, tmp_path, 0, number) == ""


@pytest.mark.full
@pytest.mark.timeout(7200)
@pytest.mark.parametrize(("what", "number"), [("reading", 4000), ("commands", 600), ("repair", 2000), ("split", 600)])
def test_no_damage_of_many_has_a_wrong_answer(what: str, number: int, tmp_path: Path) -> None:
    assert wrong_answers(what, tmp_path, 100_000, number) == ""
