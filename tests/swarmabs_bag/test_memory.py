"""Bags that are larger than the memory: read piece by piece, or refused at once where all of it would be needed."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from tests.swarmabs_bag.damage import joined, record, sealed, split

from swarmabs_bag.arrays import available_memory
from swarmabs_bag.records import inner_records, uncompress

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
MEBIBYTE = 2**20
SIZE = 192 * MEBIBYTE
ALLOWED = 32 * MEBIBYTE
LIMITED = f"""
import resource, sys
from pathlib import Path
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.errors import BagTooLargeError
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag
used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + {ALLOWED}, used + {ALLOWED}))
bag = sys.argv[1]
"""


def limited(program: str, bag: Path) -> str:
    """Run a program with little memory on a bag, and return what it says."""
    found = subprocess.run(
        [sys.executable, "-c", LIMITED + program, str(bag)],
        capture_output=True,
        text=True,
        check=False,
        env=ENVIRONMENT,
    )
    return found.stdout + found.stderr


@pytest.fixture(scope="module")
def large(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag several times larger than what a program is allowed: one chunk again and again, not compressed."""
    records = split((bag / "bag_0.mcap").read_bytes())
    data = b"".join(uncompress(found) for found in records if found.opcode == Opcode.CHUNK)
    messages = b"".join(
        record(opcode, data[begin:end]) for opcode, begin, end in inner_records(data, 0) if opcode == Opcode.MESSAGE
    )
    chunk = stored(data + messages * (4 * MEBIBYTE // len(messages)))
    path = tmp_path_factory.mktemp("large") / "x.mcap"
    path.write_bytes(sealed(joined(records[:1]) + chunk * (SIZE // len(chunk))))
    return path


def stored(data: bytes) -> bytes:
    """Return a chunk without compression and without CRC."""
    head = struct.pack("<QQQII", 0, 400_000_000, len(data), 0, 0)
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(data)) + data)


@pytest.mark.timeout(120)
def test_large_bag_is_described_and_iterated_over(large: Path) -> None:
    program = """
info = bag_info(bag)
print(info.complete, info.problem, info.size > 2**27, info.message_count == sum(1 for _ in open_bag(bag).messages()))
"""
    assert limited(program, large) == "True None True True\n"


def test_arrays_of_a_large_bag_are_refused(large: Path) -> None:
    program = """
try:
    load_arrays(bag)
except BagTooLargeError as error:
    print(error)
"""
    said = limited(program, large)
    assert said.startswith(f"{large}: its arrays take about ")
    assert said.count("\n") == 1


@pytest.mark.parametrize(("files", "left"), [(("5000", "4000"), 1000), (("max", "4000"), None), ((), None)])
def test_limit_of_a_container_counts(
    files: Sequence[str], left: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, content in zip(("memory.max", "memory.current"), files, strict=False):
        (tmp_path / name).write_text(f"{content}\n", encoding="ascii")
    monkeypatch.setattr("swarmabs_bag.arrays._GROUP", tmp_path)
    found = available_memory()
    assert found == left if left is not None else found > 5000
