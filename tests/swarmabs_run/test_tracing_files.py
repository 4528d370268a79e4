"""The tracing library's files: none is left over, and none is taken from whoever uses it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from swarmabs_run import tracing_files
from swarmabs_run.tracing_files import tracing_files_removed

_MAPPER = (
    "import mmap, sys; f = open(sys.argv[1], 'r+b'); m = mmap.mmap(f.fileno(), 0); f.close();"
    "print('mapped', flush=True); sys.stdin.read()"
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tracing_files, "_SHARED_MEMORY", tmp_path)
    return tmp_path


def made(folder: Path, name: str = "lttng-ust-wait-6") -> Path:
    path = folder / name
    path.write_bytes(bytes(4096))
    return path


@contextmanager
def mapped(path: Path) -> Iterator[None]:
    """Let another process map a file, as a program does that has loaded rclpy."""
    with subprocess.Popen(
        [sys.executable, "-c", _MAPPER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"mapped\n"
        yield
        process.communicate()


def test_files_that_the_block_makes_are_removed_also_after_an_error(folder: Path) -> None:
    def interrupted() -> None:
        with tracing_files_removed():
            made(folder)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not list(folder.iterdir())


def test_a_file_that_was_left_over_before_is_removed_too(folder: Path) -> None:
    made(folder)
    with tracing_files_removed():
        pass
    assert not list(folder.iterdir())


def test_a_file_that_another_program_uses_stays_until_the_last_one_ends(folder: Path) -> None:
    with tracing_files_removed():
        path = made(folder)
        other = mapped(path)
        other.__enter__()
    assert path.exists(), "it was made in the block, but another program uses it now"
    with tracing_files_removed():
        other.__exit__(None, None, None)
    assert not path.exists()


def test_other_files_and_those_of_others_stay(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = made(folder, "someone-elses")
    with tracing_files_removed():
        theirs = made(folder)
        monkeypatch.setattr(tracing_files.os, "getuid", lambda: 12345)
    assert other.exists()
    assert theirs.exists()


def test_a_file_of_all_users_stays_where_processes_cannot_be_examined(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared, own = made(folder), made(folder, f"lttng-ust-wait-6-{tracing_files.os.getuid()}")
    monkeypatch.setattr(tracing_files, "_mapped_by_others", lambda: (set(), True))
    with tracing_files_removed():
        new = made(folder, "lttng-ust-wait-8")
    assert shared.exists()
    assert not own.exists()
    assert not new.exists(), "nobody else can have had the time to use it"


def test_whoever_started_a_process_removes_them_as_long_as_he_lives(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with tracing_files_removed(if_orphaned=True):
        path = made(folder)
    assert path.exists()
    with tracing_files_removed(if_orphaned=True):
        monkeypatch.setattr(tracing_files.os, "getppid", lambda: 1)
    assert not path.exists()
