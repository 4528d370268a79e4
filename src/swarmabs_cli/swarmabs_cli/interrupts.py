"""What Ctrl-C and its kin do to a command: the first one ends it in order, those that follow change nothing."""

from __future__ import annotations

import signal
from typing import NoReturn

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def interrupt_once() -> None:
    """Let the first of these signals raise `KeyboardInterrupt` and ignore all others, until this process has ended."""
    for number in _SIGNALS:
        signal.signal(number, _interrupt)


def no_more_interrupts() -> None:
    """Ignore these signals from now on, where `interrupt_once` was called: what is left to do is short."""
    if signal.getsignal(signal.SIGINT) is _interrupt:
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def _interrupt(*_: object) -> NoReturn:
    no_more_interrupts()
    raise KeyboardInterrupt
