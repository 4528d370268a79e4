"""The count of mutants: what tests notice and what they miss."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = """
def bounded(value: int, most: int = 3) -> int:
    return most if value > most else value

def never(value):
    return value + 1

def register(names, name):
    names.add(name)

NAMES = set()
register(NAMES, "bounded")
"""
TESTS = """
from bounded import NAMES, bounded

def test_bounded():
    assert (bounded(1), bounded(4), NAMES) == (1, 3, {"bounded"})
"""


@pytest.mark.skipif(sys.version_info < (3, 12), reason="lines are watched by sys.monitoring, new in Python 3.12")
@pytest.mark.system
def test_mutants_are_noticed_or_missed(tmp_path: Path) -> None:
    (tmp_path / "bounded.py").write_text(SOURCE, encoding="utf-8")
    (tmp_path / "test_bounded.py").write_text(TESTS, encoding="utf-8")
    words = ["pytest", "-p", "tests.mutants", "-c", "/dev/null", "--rootdir", tmp_path, "--mutate", "bounded.py"]
    environment = {**os.environ, "PYTHONPATH": f"{Path(__file__).parents[1]}:{tmp_path}"}
    done = subprocess.run(
        [sys.executable, "-m", *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    missed = {line.partition("bounded.py:")[2] for line in done.stdout.splitlines() if line.startswith("missed")}
    assert missed == {
        "3: value > most -> value >= most",  # which is the same
        "6: return value + 1 -> return None",
        "6: value + 1 -> value - 1",
        "6: 1 -> 2",
    }, done.stderr
    assert "all: 3 of 7" in done.stdout
