"""The folder of the fleet's keys: made once, readable by its owner only, and kept by every later deployment."""

from __future__ import annotations

import importlib
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from collections.abc import Callable

_OTHERS = stat.S_IRWXG | stat.S_IRWXO


class Keys:
    """What is secret or signed, by name; each thing is made at its first use and never again.

    Parameters
    ----------
    folder : Path
        The folder, made if it does not exist.

    Raises
    ------
    InputError
        If others may read it, it cannot be used, or the library that makes keys is missing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            importlib.import_module("cryptography")
        except ImportError as error:
            raise InputError(f"{error}; keys need the Python package cryptography: install it") from error
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            mode = folder.stat().st_mode
        except OSError as error:
            raise InputError(f"the folder of keys {folder} cannot be used: {error.strerror}; name another") from error
        if mode & _OTHERS:
            raise InputError(f"others may enter the folder of keys {folder}; close it: chmod 700 {folder}")

    def kept(self, name: str, make: Callable[[], bytes]) -> bytes:
        """Return what is kept under a name, made if it is not there yet.

        Raises
        ------
        InputError
            If it cannot be read, or others may read it.
        RunError
            If it cannot be written.
        """
        path = self.folder / name
        try:
            with path.open("rb") as file:
                if os.fstat(file.fileno()).st_mode & _OTHERS:
                    raise InputError(f"others may read the key {path}; take it for known, remove it and deploy anew")
                return file.read()
        except FileNotFoundError:
            content = make()
            self.write(name, content)
            return content
        except OSError as error:
            raise InputError(f"{path} cannot be read: {error.strerror}; check the path and its permissions") from error

    def write(self, name: str, content: bytes) -> None:
        """Keep something under a name, whole or not at all.

        Raises
        ------
        RunError
            If it cannot be written.
        """
        path = self.folder / name
        part = path.with_name(f".{path.name}.part")
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            part.unlink(missing_ok=True)
            descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            part.replace(path)
        except OSError as error:
            with suppress(OSError):
                part.unlink()
            raise RunError(f"{path}: {error.strerror}; free space, then deploy again") from error

    def read(self, name: str) -> bytes | None:
        """Return what is kept under a name, None if there is nothing."""
        try:
            return (self.folder / name).read_bytes()
        except OSError:
            return None
