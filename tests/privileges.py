"""Root without root's right to open everything, for tests of files and folders that may not be written."""

import ctypes
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")

_VERSION_3 = 0x20080522
_OVERRIDES = 0b110
"""CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH."""


class _Header(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int))


class _Sets(ctypes.Structure):
    _fields_ = (("effective", ctypes.c_uint32), ("permitted", ctypes.c_uint32), ("inheritable", ctypes.c_uint32))


def respect_permissions() -> None:
    """Let the permissions of files hold for this thread, even if it is root's, and for what it starts from now on."""
    libc = ctypes.CDLL(None, use_errno=True)
    header, sets = _Header(_VERSION_3, 0), (_Sets * 2)()
    for call in ("capget", "capset"):
        if getattr(libc, call)(ctypes.byref(header), sets):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), call)
        sets[0].effective &= ~_OVERRIDES
        sets[0].permitted &= ~_OVERRIDES


def respecting_permissions(act: Callable[[], T]) -> T:
    """Do something in a thread for which the permissions of files hold; return what it returns, or raise its error."""
    with ThreadPoolExecutor(max_workers=1, initializer=respect_permissions) as pool:
        return pool.submit(act).result()
