"""Processes that tests start: how they are found, and how a test waits for what they do."""

import configparser
import os
import time
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SEARCH_PATH = {"PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])}
"""Variables with which processes can import the tests' own modules: Python does not search where it was started."""

MARK = "SWARMABS_TEST_MARK"
"""Environment variable that every process which a test starts inherits."""


def marked_processes(mark: str) -> dict[int, str]:
    """Return the names of the living processes that a test with this mark has started, by process id."""
    return carrying(f"{MARK}={mark}")


def carrying(variable: str) -> dict[int, str]:
    """Return the names of the other living processes that have a variable in their environment, by process id."""
    needle = variable.encode()
    found = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit() or int(folder.name) == os.getpid():
            continue
        try:
            if needle in (folder / "environ").read_bytes().split(b"\0"):
                found[int(folder.name)] = (folder / "comm").read_text().strip()
        except OSError:  # it has ended, or is another user's
            continue
    return found


def until(condition: Callable[[], object], what: str | Callable[[], str], seconds: float = 60.0) -> None:
    """Wait until a condition holds; fail if it does not in time. `what` it is may be a text made only then."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() >= deadline:
            raise AssertionError(f"not within {seconds:g} s: {what if isinstance(what, str) else what()}")
        time.sleep(0.01)


def programs(package: str) -> list[EntryPoint]:
    """Return the programs that a package installs, from its setup.cfg."""
    metadata = configparser.ConfigParser()
    metadata.read(ROOT / "src" / package / "setup.cfg", encoding="utf-8")
    lines = metadata.get("options.entry_points", "console_scripts", fallback="").strip().splitlines()
    return [EntryPoint(*line.split(" = "), "console_scripts") for line in lines]
