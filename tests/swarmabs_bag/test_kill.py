"""A writer that is killed loses at most the chunk it was filling, and what is on the disk can be read."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import pytest

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag

CHUNK_SECONDS = 0.05
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def killed_writer(folder: Path, seconds: float) -> list[tuple[int, float, float]]:
    """Start a writer, kill it some seconds after its first step, and return what it said of its steps."""
    script = Path(__file__).with_name("endless_writer.py")
    log = folder.with_suffix(".log")
    with log.open("w+", encoding="utf-8") as said:
        process = subprocess.Popen(
            [sys.executable, str(script), str(folder), str(CHUNK_SECONDS)], stdout=said, env=ENVIRONMENT
        )
        try:
            deadline = time.monotonic() + 15
            while log.stat().st_size == 0 and time.monotonic() < deadline:
                time.sleep(0.005)
            time.sleep(seconds)
        finally:
            process.kill()
            process.wait()
    lines = log.read_text(encoding="utf-8").splitlines()
    return [(int(step), float(began), float(ended)) for step, began, ended in map(str.split, lines)]


@pytest.mark.parametrize("seed", range(8))
def test_killed_writer_loses_no_more_than_its_last_chunk(seed: int, tmp_path: Path) -> None:
    steps = killed_writer(tmp_path / "bag", random.Random(seed).uniform(0.0, 0.4))
    assert [path.name for path in (tmp_path / "bag").iterdir()] == ["bag_0.mcap"]
    found = [time // 1_000_000 for _, time, _ in open_bag(tmp_path / "bag", damaged=True).messages()]
    assert all(later - earlier in {0, 1} for earlier, later in pairwise(found))
    # The chunk that was open when the last step began was opened less than CHUNK_SECONDS earlier.
    _, last_began, _ = steps[-1]
    safe = [step for step, _, ended in steps if ended <= last_began - CHUNK_SECONDS]
    assert len(found) >= 4 * len(safe)
    assert found[:4] == [0, 0, 0, 0] or not safe


def test_killed_bag_says_what_can_be_read(tmp_path: Path) -> None:
    killed_writer(tmp_path / "bag", 0.2)
    with pytest.raises(
        DamagedBagError, match=r"bag_0\.mcap is incomplete: .* messages before it, up to .* s, can be read"
    ):
        open_bag(tmp_path / "bag")
    info = bag_info(tmp_path / "bag")
    assert not info.complete
    assert info.message_count > 0
    assert info.topics[1].name == "/plane/state"
