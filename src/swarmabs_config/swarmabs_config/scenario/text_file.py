"""Read text files that a user names; only regular files of limited size are accepted."""

import os
import stat
from pathlib import Path

from swarmabs_config.model.errors import ScenarioError
from swarmabs_config.model.fields import nearest

from .yaml_tree import LARGEST_TEXT


def read_text(path: Path, kind: str = "scenario", form: str = "YAML") -> str:
    """Return the text of a file that a user has named; `kind` and `form` describe it in errors.

    Raises
    ------
    ScenarioError
        If it cannot be read, is not UTF-8, or is larger than `LARGEST_TEXT`.
    """
    source = str(path)
    data = _read_bytes(path, source, kind, form)
    if (nul := data.find(b"\0")) >= 0:
        raise ScenarioError(
            source, "not a text file: it has a NUL byte", f"give a {kind} in {form}", line=_line(data, nul)
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as exc:
        raise ScenarioError(
            source,
            f"not UTF-8: byte 0x{data[exc.start]:02x} at offset {exc.start}",
            "save the file as UTF-8",
            line=_line(data, exc.start),
        ) from exc


def _read_bytes(path: Path, source: str, kind: str, form: str) -> bytes:
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise ScenarioError(source, "not a regular file", f"give a {kind} file in {form}")
            data = file.read(LARGEST_TEXT + 1)
    except IsADirectoryError as exc:
        raise ScenarioError(source, "is a directory", f"give a {kind} file in {form}") from exc
    except FileNotFoundError as exc:
        raise ScenarioError(source, "no such file", _remedy_missing(path)) from exc
    except (OSError, ValueError) as exc:  # ValueError: the path has a NUL
        reason = exc.strerror if isinstance(exc, OSError) and exc.strerror else str(exc)
        raise ScenarioError(source, f"cannot be read: {reason}", "check the path and its permissions") from exc
    if len(data) > LARGEST_TEXT:
        raise ScenarioError(
            source, f"larger than {LARGEST_TEXT} bytes", "shorten it; 'swarm.generate' describes many robots"
        )
    return data


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a file without blocking, so that a pipe without a writer can be rejected."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))  # Windows has none


def _remedy_missing(path: Path) -> str:
    try:
        files = [entry for entry in path.parent.iterdir() if not entry.name.startswith(".")]
    except OSError:
        return "check the path"
    names = sorted(entry.name for entry in files if entry.suffix in {".yaml", ".yml", path.suffix})
    return nearest(path.name, names[:5]) if names and path.suffix else "check the path"


def _line(data: bytes, offset: int) -> int:
    return data.count(b"\n", 0, offset) + 1
