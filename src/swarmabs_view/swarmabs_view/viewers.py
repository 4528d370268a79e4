"""Viewers started by commands: of a bag or a swarm in this process, of a run in processes that end with it."""

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
"""Time after which a viewer that does not end is killed, s."""
MARKERS_LOG = "markers.log"


def view_live(target: str, *, port: int, ready: Callable[[str], None]) -> None:
    """Show a running swarm until the user ends it: a run by its folder, or a namespace of the ROS domain.

    `ready` receives the address of the page.

    Raises
    ------
    InputError
        If it is neither, the run has ended, or the port is taken.
    """
    need_web_server()
    from swarmabs_view.sources import show_live  # noqa: PLC0415 - needs aiohttp and ROS

    with bound(port) as listener:
        show_live(target, listener, ready)


class ViewerProcess:
    """A process that shows a run until its standard input ends.

    The secret is the first line of its input, because other users can see its arguments. It inherits the descriptors.
    """

    def __init__(
        self, module: str, arguments: Sequence[str], *, secret: str = "", descriptors: Sequence[int] = ()
    ) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", module, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            pass_fds=descriptors,
            start_new_session=True,  # Ctrl-C in a terminal only reaches the command
        )
        assert self._process.stdin is not None  # noqa: S101 - a pipe
        self._pipe = self._process.stdin
        with suppress(OSError):  # a viewer that has died must not affect the run
            self._pipe.write(secret.encode() + b"\n")
            self._pipe.flush()

    def wait(self) -> None:
        """Wait until the process ends by itself, or for Ctrl-C."""
        with suppress(KeyboardInterrupt):
            self._process.wait()

    def close(self) -> int:
        """End the process, killing it if it hangs, and return its exit code."""
        with suppress(OSError):
            self._pipe.close()
        try:
            self._process.wait(END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
        return self._process.wait()


class PageViewer:
    """The page of a run, or of several in turn; it opens its port first, so that a taken port is reported at once.

    With `steered`, the page at `steering_url` can steer the run: its token follows the `#`, a part of the address that
    browsers do not send.

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
        """Show the run in a folder, which is about to start, in the place of an earlier one.

        Pages reconnect by themselves; until the new viewer accepts their connections, they wait at the port.
        """
        if self._process is not None:
            self._process.close()
        number = self._listener.fileno()
        self._process = ViewerProcess(
            "swarmabs_view.sources", [str(folder), str(number)], secret=self._token, descriptors=[number]
        )

    def wait(self) -> None:
        """Wait until the viewer ends by itself, or for Ctrl-C."""
        if self._process is not None:
            self._process.wait()

    def close(self) -> None:
        """End the viewer."""
        self._listener.close()
        if self._process is not None:
            self._process.close()


@contextmanager
def markers_viewer(folder: Path, *, ros: bool, foxglove_port: int | None, clock: bool) -> Iterator[None]:
    """Show the run in a folder, which is about to start, in RViz and Foxglove inside the block.

    `ros` publishes on ROS topics, `clock` also publishes the time of the steps where it is not the machine's; Foxglove
    is served if a port is given.
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
        sys.stderr.write(f"warning: the process for RViz and Foxglove failed; see {folder / 'logs' / MARKERS_LOG}\n")
