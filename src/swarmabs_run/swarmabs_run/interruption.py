"""An end on demand: whatever asks a process to end, it ends in order."""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def _handled_by(handler: Callable[..., None]) -> Iterator[None]:
    """Have the signals that ask for an end handled so, where Python allows it: in the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)


@contextmanager
def terminable() -> Iterator[None]:
    """Make SIGTERM interrupt as Ctrl-C does."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with _handled_by(interrupt):
        yield


@contextmanager
def end_asked() -> Iterator[Callable[[], bool]]:
    """Note the wish to end instead of raising, for work that must not be cut in two.

    Yields
    ------
    callable
        Tells whether an end was asked for.
    """
    asked = False

    def note(*_: object) -> None:
        nonlocal asked
        asked = True

    with _handled_by(note):
        yield lambda: asked
