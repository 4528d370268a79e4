"""Messages and errors of the set-up."""

from __future__ import annotations

import sys
import time

FAILED = 1
UNSUITABLE = 2
CLEAR_LINE = "\r\033[K"  # removes the progress line from the terminal


class SetupError(Exception):
    """The set-up cannot continue; the text is for the user, `status` is the exit code.

    `FAILED` means that a command failed, `UNSUITABLE` that this machine or checkout cannot be used as it is and nothing
    was started.
    """

    def __init__(self, text: str, status: int = FAILED) -> None:
        super().__init__(text)
        self.status = status


def say(text: str) -> None:
    """Print a line to stderr; stdout is reserved for the command."""
    print(f"{CLEAR_LINE if sys.stderr.isatty() else ''}swarm: {text}", file=sys.stderr, flush=True)


class Stage:
    """Prints the start, the progress (on a terminal) and the duration of a stage."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._on_terminal = sys.stderr.isatty()
        self._shown = ""
        self._started = time.monotonic()
        say(f"{title} ...")

    def progress(self, text: str) -> None:
        """Show `text` until the next line, if there is a terminal."""
        if self._on_terminal and text != self._shown:
            self._shown = text
            print(f"{CLEAR_LINE}  {text}", end="", file=sys.stderr, flush=True)

    def done(self) -> None:
        """Print that the stage is complete, with its duration."""
        say(f"{self._title}: {time.monotonic() - self._started:.1f} s")
