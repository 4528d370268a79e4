"""The state of the set-up: content keys, stamps, the hash of file metadata, and the lock.

A stamp is written atomically after its stage and removed before its stage begins, so an existing stamp is valid even
after an interruption.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
from typing import Dict, Iterator, List, NoReturn

from _setup.report import UNSUITABLE, SetupError, say

LOCK_FILE = ".setup.lock"
STAMPS = ".swarmabs"  # a folder of stamps in .venv, another in install
# Generated among the sources by running and testing them; changes to these do not change the package.
BY_PRODUCTS = ("__pycache__", ".pytest_cache", ".mypy_cache", ".ruff_cache", ".hypothesis")


def files_below(folder: str) -> Iterator[str]:
    """Paths of all source files below the folder, in a fixed order."""
    for entry in sorted(os.scandir(folder), key=lambda found: found.name):
        if entry.name in BY_PRODUCTS or entry.name.endswith((".pyc", ".egg-info", "~", ".swp")):
            continue
        if entry.is_dir(follow_symlinks=False):
            yield from files_below(entry.path)
        else:
            yield entry.path


def packages_in(source: str) -> List[str]:
    """Names of the packages: folders of src with a package.xml."""
    described = (name for name in os.listdir(source) if os.path.exists(os.path.join(source, name, "package.xml")))
    return sorted(described)


def metadata_hash(paths: List[str], *facts: object) -> str:
    """Hash of facts and of name, size and times of files, without reading them.

    It includes the time of the last status change, which users cannot set.
    """
    digest = hashlib.sha256(repr(facts).encode())
    for path in paths:
        try:
            stat = os.stat(path)
        except FileNotFoundError:  # removed since it was listed; the hash differs, as it must
            continue
        digest.update(f"{path}\0{stat.st_size}\0{stat.st_mtime_ns}\0{stat.st_ctime_ns}\n".encode())
    return digest.hexdigest()


def content_key(folder: str, *facts: object) -> str:
    """Hash of facts and of names, execute permissions and contents of all files below a folder."""
    digest = hashlib.sha256(repr(facts).encode())
    for path in files_below(folder):
        name = os.path.relpath(path, folder)
        try:
            executable = os.access(path, os.X_OK)
            with open(path, "rb") as file:
                content = hashlib.sha256(file.read()).hexdigest()
        except FileNotFoundError:  # removed since it was listed, or a broken link
            continue
        digest.update(f"{name}\0{executable}\0{content}\n".encode())
    return digest.hexdigest()


def file_key(path: str) -> str:
    """Hash of the content of a file."""
    with open(path, "rb") as file:
        return hashlib.sha256(file.read()).hexdigest()


def text_key(*facts: object) -> str:
    """Hash of facts."""
    return hashlib.sha256(repr(facts).encode()).hexdigest()


def read_stamp(path: str) -> Dict[str, str]:
    """Facts of a stamp, empty if it does not exist or is invalid."""
    try:
        with open(path, encoding="utf-8") as file:
            facts = json.load(file)
    except (OSError, ValueError):
        return {}
    return facts if isinstance(facts, dict) else {}


def write_stamp(path: str, **facts: str) -> None:
    """Write a stamp atomically."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    unfinished = f"{path}.{os.getpid()}"
    with open(unfinished, "w", encoding="utf-8") as file:
        json.dump(facts, file)
    os.replace(unfinished, path)


def remove_stamp(path: str) -> None:
    """Remove a stamp, if it exists."""
    with contextlib.suppress(FileNotFoundError):
        os.remove(path)


@contextlib.contextmanager
def only_one(root: str) -> Iterator[int]:
    """Hold the set-up lock of the checkout, waiting for another set-up if necessary; yield its file descriptor.

    Children that inherit the descriptor keep the lock: after a set-up is killed, the next one waits for any installer
    or compiler that is still running.
    """
    try:
        lock = os.open(os.path.join(root, LOCK_FILE), os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise_unwritable(root, error)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say(f"waiting for {holder(lock)}, which is setting up this checkout")
            fcntl.flock(lock, fcntl.LOCK_EX)
        os.truncate(lock, 0)
        os.pwrite(lock, str(os.getpid()).encode(), 0)
        yield lock
    finally:
        os.close(lock)


def holder(lock: int) -> str:
    """Describe the process that holds the lock."""
    pid = os.pread(lock, 20, 0).decode(errors="replace")
    if not pid.isdigit():
        return "another process"
    return f"process {pid}" if os.path.exists(f"/proc/{pid}") else f"children of process {pid}"


def raise_unwritable(root: str, error: OSError) -> NoReturn:
    """Raise `SetupError` for an error of the file system."""
    raise SetupError(
        f"cannot write in {root}: {error.strerror}; check its owner and permissions", UNSUITABLE
    ) from error
