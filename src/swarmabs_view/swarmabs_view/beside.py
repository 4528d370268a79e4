"""The viewer beside a run: a process of its own, which ends with the command that has started it."""

from __future__ import annotations

import secrets
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_view.main import listening, need_packages, serve

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

END_SECONDS = 5.0
"""Longest time, s, that the viewer may take to end; then it is killed."""


class Viewer:
    """The side of the command: holds the port from the beginning, so that a taken one is refused in time.

    Parameters
    ----------
    port : int
        0 for any free one.
    steered : bool
        Whether the run can be steered from the page, by those who know the token.

    Attributes
    ----------
    url : str
        Address of the page.
    steering_url : str or None
        Address with the token, which stands behind the `#`: browsers keep that part for themselves.

    Raises
    ------
    InputError
        If the port is taken, or the web server is not installed.
    """

    def __init__(self, port: int, *, steered: bool = False) -> None:
        need_packages()
        from swarmabs_view.server import url_of  # noqa: PLC0415 - needs aiohttp

        self._listener = listening(port)
        self.url = url_of(self._listener)
        self._token = secrets.token_urlsafe(24) if steered else ""
        self.steering_url = f"{self.url}#steer={self._token}" if steered else None
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self, folder: Path) -> None:
        """Show the run in a folder, which is about to begin."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "swarmabs_view.beside", str(folder), str(self._listener.fileno())],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=(self._listener.fileno(),),
            start_new_session=True,  # Ctrl-C in a terminal is for the command alone
        )
        self._listener.close()
        assert self._process.stdin is not None  # noqa: S101 - it is a pipe
        # By the pipe: other users can see arguments.
        with suppress(OSError):  # a view that has died is no matter of the run
            self._process.stdin.write(self._token.encode() + b"\n")
            self._process.stdin.flush()

    def wait(self) -> None:
        """Wait until the viewer has ended by itself, or Ctrl-C."""
        if self._process is not None:
            with suppress(KeyboardInterrupt):
                self._process.wait()

    def close(self) -> None:
        """End the viewer; one that hangs is killed."""
        self._listener.close()
        if self._process is None:
            return
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def main() -> int:
    """Serve what a run does until standard input ends."""
    from swarmabs_view.following import RunView  # noqa: PLC0415 - needs the whole of ROS
    from swarmabs_view.live import closed  # noqa: PLC0415

    folder, descriptor = sys.argv[1:]
    run = RunView(Path(folder), sys.stdin.buffer.readline().decode().strip() or None)
    with socket.socket(fileno=int(descriptor)) as listener:
        serve(listener, run.session, run.follow, run.steer, lambda: closed(0))
    return 0


if __name__ == "__main__":
    sys.exit(main())
