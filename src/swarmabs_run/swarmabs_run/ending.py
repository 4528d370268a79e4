"""How a process ends: cleanly on every termination signal, and always when its parent ends."""

from __future__ import annotations

import ctypes
import os
import signal
import threading
from contextlib import contextmanager, suppress
from math import inf
from typing import TYPE_CHECKING, NoReturn

from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

_PR_SET_PDEATHSIG = 1

GRACE = "SWARMABS_END_GRACE"
"""Environment variable with the time, s, that nodes have to exit by themselves, for profilers; default: none."""
TERMINATION = tuple(number for number in signal.Signals if number.name in {"SIGINT", "SIGTERM", "SIGHUP"})
"""The signals that ask a process to end; Windows has no SIGHUP."""


def end_grace() -> float:
    """Return the time, s, that nodes have to exit by themselves.

    Raises `InputError` if the variable `GRACE` does not hold a time.
    """
    text = os.environ.get(GRACE) or "0"
    with suppress(ValueError):
        if 0.0 <= (seconds := float(text)) < inf:
            return seconds
    raise InputError(f"{GRACE}: {text!r} is not a time in seconds; give a number such as 2.5, or unset the variable")


@contextmanager
def _handled_by(handler: Callable[..., None]) -> Iterator[None]:
    """Install a handler for the termination signals, if this is the main thread; Python allows it nowhere else."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.signal(number, handler) for number in TERMINATION}
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)


@contextmanager
def terminable() -> Iterator[None]:
    """Make SIGTERM interrupt the process as Ctrl-C does."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with _handled_by(interrupt):
        yield


@contextmanager
def end_asked() -> Iterator[Callable[[], bool]]:
    """Only record termination signals, for work that must not be interrupted; yield a function that reports them."""
    asked = False

    def note(*_: object) -> None:
        nonlocal asked
        asked = True

    with _handled_by(note):
        yield lambda: asked


def interrupt_once() -> None:
    """Let the first termination signal raise `KeyboardInterrupt`, and ignore all later ones.

    It may have come before: ``scripts/swarm`` blocks these signals until this call.
    """
    for number in TERMINATION:
        signal.signal(number, _interrupt)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINATION)


def no_more_interrupts() -> None:
    """Ignore termination signals from now on if `interrupt_once` was called: the remaining work is short."""
    if signal.getsignal(signal.SIGINT) is _interrupt:
        for number in TERMINATION:
            signal.signal(number, signal.SIG_IGN)


def _interrupt(*_: object) -> NoReturn:
    no_more_interrupts()
    raise KeyboardInterrupt


def die_with_parent(parent: int) -> None:
    """Have the kernel kill this process when its parent ends; call it first in the child.

    If the parent, given by its process id, has already ended, this process ends at once.
    """
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(1)
