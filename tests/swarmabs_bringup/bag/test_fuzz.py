"""Damaged bags of all kinds: no traceback, no wrong content, no hang and no more memory than there should be."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).with_name("fuzz.py")
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def answers(bag: Path, folder: Path, first: int, number: int) -> str:
    """Return what the fuzzer says of a range of seeds; nothing but the last line if all answers are right."""
    found = subprocess.run(
        [sys.executable, str(PROGRAM), str(bag / "bag_0.mcap"), str(folder), str(first), str(number)],
        capture_output=True,
        text=True,
        check=False,
        env=ENVIRONMENT,
    )
    return found.stdout + found.stderr


@pytest.mark.timeout(120)
def test_no_damage_has_a_wrong_answer(bag: Path, tmp_path: Path) -> None:
    assert answers(bag, tmp_path, 0, 200) == "200 damages, 0 wrong answers\n"


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_no_damage_of_many_has_a_wrong_answer(bag: Path, tmp_path: Path) -> None:
    assert answers(bag, tmp_path, 1000, 15_000) == "15000 damages, 0 wrong answers\n"
