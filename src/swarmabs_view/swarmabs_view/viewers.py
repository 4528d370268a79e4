"""Viewers as commands start them: of a bag or a swarm in this process, of a run in processes that end with it."""

from __future__ import annotations

import os
import secrets
import subprocess
import sys
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from swarmabs_view.ports import bound, need_web_server, url_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path
    from types import TracebackType

    from typing_extensions import Self

END_SECONDS = 5.0
"""Longest time, s, that a viewer may take to end; then it is killed."""
MARKERS_LOG = "markers.log"


def view_live(target: str, *, port: int, ready: Callable[[str], None]) -> None:
    """Show a running swarm until the user has seen enough: a run by its folder, or a namespace of the ROS domain.

    `ready` is told the address of the page.

    Raises
    ------
    InputError
        If it is neither, the run is over, or the port is taken.
    """
    need_web_server()
    from swarmabs_view.sources import show_live  # noqa: PLC0415 - needs aiohttp and the whole of ROS

    with bound(port) as listener:
        show_live(target, listener, ready)


class ViewerProcess:
    """A process that shows a run until its standard input ends.

    Other users can see its arguments, but not the secret, which is the first line that it reads. It inherits the files
    behind the descriptors.
    """

    def __init__(
        self, module: str, arguments: Sequence[str], *, secret: str = "", descriptors: Sequence[int] = ()
    ) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=descriptors,
            start_new_session=True,  # Ctrl-C in a terminal is for the command alone
        )
        assert self._process.stdin is not None  # noqa: S101 - it is a pipe
        self._pipe = self._process.stdin
        with suppress(OSError):  # a viewer that has died is no matter of the run
            self._pipe.write(secret.encode() + b"\n")
            self._pipe.flush()

    def wait(self) -> None:
        """Wait until it has ended by itself, or Ctrl-C."""
        with suppress(KeyboardInterrupt):
            self._process.wait()

    def close(self) -> int:
        """End it, and return its exit code; one that hangs is killed."""
        with suppress(OSError):
            self._pipe.close()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
        return self._process.wait()


class PageViewer:
    """The page of a run: holds its port from the beginning, so that a taken one is refused in time.

    A run can be `steered` by the page whose address is `steering_url`: its token stands behind the `#`, and browsers
    keep that part for themselves.

    Raises
    ------
    InputError
        If the port is taken, or the web server is not installed.
    """

    def __init__(self, port: int, *, steered: bool = False) -> None:
        need_web_server()
        self._listener = bound(port)
        self.url = url_of(self._listener)
        self._token = secrets.token_urlsafe(24) if steered else ""
        self.steering_url = f"{self.url}#steer={self._token}" if steered else None
        self._process: ViewerProcess | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self, folder: Path) -> None:
        """Show the run in a folder, which is about to begin."""
        number = self._listener.fileno()
        self._process = ViewerProcess(
            "swarmabs_view.sources", [str(folder), str(number)], secret=self._token, descriptors=[number]
        )
        self._listener.close()

    def wait(self) -> None:
        """Wait until the viewer has ended by itself, or Ctrl-C."""
        if self._process is not None:
            self._process.wait()

    def close(self) -> None:
        """End the viewer."""
        self._listener.close()
        if self._process is not None:
            self._process.close()


@contextmanager
def markers_viewer(folder: Path, *, ros: bool, foxglove_port: int | None, clock: bool) -> Iterator[None]:
    """Show the run in a folder, which is about to begin, to RViz and Foxglove for the time of the block.

    `ros` publishes on topics of ROS, `clock` the time of the steps too, where it is not the machine's; Foxglove is
    served on its port, if there is one.
    """
    port = -1 if foxglove_port is None else foxglove_port
    parameters = [f"ros:={str(ros).lower()}", f"clock:={str(clock).lower()}", f"foxglove_port:={port}"]
    process = ViewerProcess("swarmabs_view.visualization.run_markers", [str(os.getpid()), str(folder), *parameters])
    code = 0
    try:
        yield
    finally:
        code = process.close()
    if code > 0:
        sys.stderr.write(f"warning: the markers have failed; see {folder / 'logs' / MARKERS_LOG}\n")
