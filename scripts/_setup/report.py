"""What the set-up says while it works, and how it fails."""

from __future__ import annotations

import sys
import time

FAILED = 1
UNSUITABLE = 2
CLEAR_LINE = "\r\033[K"  # takes progress off the terminal


class SetupError(Exception):
    """The set-up cannot go on; the text is for the user, `status` is the exit code.

    `FAILED` when something that was started failed, `UNSUITABLE` when this machine or
    checkout cannot be used as it is and nothing was started.
    """

    def __init__(self, text: str, status: int = FAILED) -> None:
        super().__init__(text)
        self.status = status


def say(text: str) -> None:
    """Print a line for the user; stdout belongs to the command that follows."""
    print(f"{CLEAR_LINE if sys.stderr.isatty() else ''}swarm: {text}", file=sys.stderr, flush=True)


class Stage:
    """Announce a stage, show its progress on a terminal, and say how long it took."""

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
        """Say that the stage is complete, and after how long."""
        say(f"{self._title}: {time.monotonic() - self._started:.1f} s")
