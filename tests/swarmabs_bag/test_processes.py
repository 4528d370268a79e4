"""Damaged bags of all kinds, more than fits into the memory, and a disk that fills up: most of it in other processes.

No answer to a damage is a traceback or wrong, and none takes too long or too much memory. What is larger than the
memory is read piece by piece, or refused at once where all of it would be needed.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from tests.processes import SEARCH_PATH
from tests.swarmabs_bag.answers import read_everywhere
from tests.swarmabs_bag.fuzz import KINDS
from tests.swarmabs_bag.mcap_files import chunk, inner_records, joined, record, sealed, split

from swarmabs_bag.arrays import available_memory
from swarmabs_bag.mcap.records import uncompress
from swarmabs_bag.reader import open_bag

SIZE, ALLOWED, PART = (2**20 * number for number in (96, 32, 4))
READER = f"""
import resource, sys
from pathlib import Path
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.errors import BagTooLargeError
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {ALLOWED}, used + {ALLOWED}))
bag = sys.argv[1]
info = bag_info(bag)
print(info.complete, info.problem, info.size > 2**26, info.message_count == sum(1 for _ in open_bag(bag).messages()))
try:
    load_arrays(bag)
except BagTooLargeError as error:
    print(error)
"""
WRITER = """
import math, sys
from itertools import count
from pathlib import Path
from swarmabs_bag.run.writer import BagWriter
from swarmabs_core.cdr import encode
from swarmabs_core.messages import MAIN_TOPICS, PLANE_STATE, PlaneState
with BagWriter(Path(sys.argv[1]), topics=MAIN_TOPICS, attachments={}, chunk_bytes=10_000) as writer:
    for step in count():
        writer.write(PLANE_STATE, step, encode(PlaneState(step, step, math.sin(step), math.cos(step))))
"""


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(words, capture_output=True, text=True, check=False, env=os.environ | SEARCH_PATH)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("what", ["reading", "repair", "merge"])
def test_a_few_damages_have_no_wrong_answer(what: str, tmp_path: Path) -> None:
    trial = KINDS[what](tmp_path)
    for seed in range(3):
        trial.make(seed)
        trial.attempt()


@pytest.mark.full
@pytest.mark.timeout(7200)
@pytest.mark.parametrize(("what", "number"), [("reading", 4000), ("commands", 800), ("repair", 2400), ("merge", 1200)])
def test_no_damage_of_many_has_a_wrong_answer(what: str, number: int, tmp_path: Path) -> None:
    found = run(sys.executable, "-m", "tests.swarmabs_bag.fuzz", what, tmp_path, "100000", str(number))
    assert found.returncode == 0, found.stdout + found.stderr
    assert found.stdout.startswith(f"{what}: {number} damages from seed 100000 on, 0 wrong answers")
    assert not found.stderr


@pytest.mark.system
@pytest.mark.timeout(300)
def test_large_bag_is_described_and_iterated_over_but_not_loaded(bag: Path, tmp_path: Path) -> None:
    """It is several times larger than what the program is allowed: one chunk again and again, not compressed."""
    records = split((bag / "bag_0.mcap").read_bytes())
    data = b"".join(uncompress(found) for found in records if found.opcode == Opcode.CHUNK)
    messages = b"".join(record(opcode, content) for opcode, content in inner_records(data) if opcode == Opcode.MESSAGE)
    one = chunk(data + messages * (PART // len(messages)), "", crc=0, times=(0, 400_000_000))
    file = tmp_path / "x.mcap"
    file.write_bytes(sealed(joined(records[:1]) + one * (SIZE // len(one))))
    done = run(sys.executable, "-c", READER, file)
    first, second = (done.stdout + done.stderr).splitlines()
    assert first == "True None True True"
    assert second.startswith(f"{file}: its arrays need about ")


@pytest.mark.parametrize(("files", "left"), [(("5000", "4000"), 1000), (("max", "4000"), None), ((), None)])
def test_limit_of_a_container_counts(files: Sequence[str], left: int | None, tmp_path: Path) -> None:
    for name, content in zip(("memory.max", "memory.current"), files, strict=False):
        (tmp_path / name).write_text(f"{content}\n", encoding="ascii")
    found = available_memory(tmp_path)
    assert found == left if left is not None else found > 5000


@pytest.mark.system
def test_real_disk_that_fills_up(tmp_path: Path) -> None:
    mount, copy = tmp_path / "disk", tmp_path / "copy"
    mount.mkdir()
    script = (
        f'mount -t tmpfs -o size=2m tmpfs "{mount}" || exit 77\n"$@" >/dev/null\ncode=$?\n'
        f'cp -r "{mount}/bag" "{copy}"\nexit $code\n'
    )
    alone = ("unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh")
    done = run(*alone, sys.executable, "-c", WRITER, mount / "bag")
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip(f"cannot mount a small disk here: {done.stderr.strip()}")
    assert done.returncode == 1, done.stderr
    assert "BagWriteError: cannot write" in done.stderr and "No space left on device" in done.stderr
    found = read_everywhere(copy)
    # What is missing is the last chunk at most: the space for the end was kept back.
    assert len(found) > 10_000
    assert [time for _, time, _ in open_bag(copy).messages()] == list(range(len(found)))
