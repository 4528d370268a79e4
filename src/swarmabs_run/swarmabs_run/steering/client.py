"""Client for a run that can be steered."""

from __future__ import annotations

import json
import os
import socket
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from types import TracebackType

    from typing_extensions import Self

Answer: TypeAlias = dict[str, Any]
"""An answer to a request, a JSON document (docs/how-to/steering.md)."""
SOCKET = "steer.sock"
"""Name of the socket in the folder of a run."""
LONGEST_ANSWER = 1 << 20
STATUS = "status"
"""The action that only returns the status."""
RESTARTS = ("restart", "restart_beside")
"""The actions that end the run, so that another one starts: as this one, or beside the curve of desired states."""


@contextmanager
def short_path(folder: Path) -> Iterator[Path]:
    """Yield a short path to a folder for the duration of the block; raises `OSError` if it cannot be opened.

    The path of a socket is limited to 107 characters, and the folder's path may be longer; so the short path refers to
    the folder by a file descriptor.
    """
    directory = os.open(folder, os.O_PATH | os.O_DIRECTORY)
    try:
        yield Path(f"/proc/self/fd/{directory}")
    finally:
        os.close(directory)


class SteeringClient:
    """A connection to the run in a folder; `timeout` is the longest time to wait for an answer, s.

    Raises `InputError` if the folder holds no run that can be steered.
    """

    def __init__(self, run: Path, timeout: float = 30.0) -> None:
        self._run = run
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._socket.settimeout(timeout)
        try:
            with short_path(run) as place:
                self._socket.connect(str(place / SOCKET))
        except OSError as error:
            self._socket.close()
            raise InputError(
                f"{run} is not the folder of a running simulation that you can steer ({error.strerror}: {SOCKET}); "
                "start one with run --steer"
            ) from error
        self._lines = self._socket.makefile("rb")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._lines.close()
        self._socket.close()

    def ask(self, asked: Mapping[str, object]) -> Answer:
        """Send a request and return the answer.

        Raises `RunError` if the run ends before it answers, or does not answer in time.
        """
        try:
            self._socket.sendall(json.dumps(asked).encode() + b"\n")
            line = self._lines.readline(LONGEST_ANSWER)
        except TimeoutError:
            raise RunError(
                f"{self._run}: the run does not answer; check its processes with "
                f"'swarm view --live {self._run} --terminal'"
            ) from None
        except ConnectionError:
            line = b""
        if not line.endswith(b"\n"):
            raise RunError(f"{self._run}: the run has ended before it answered")
        answer = json.loads(line)
        assert isinstance(answer, dict)  # noqa: S101 - the server sends only objects
        return answer
