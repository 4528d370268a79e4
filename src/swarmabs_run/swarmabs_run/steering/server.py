"""The socket of a run that is steered: a Unix socket in the folder of the run, for its user alone."""

from __future__ import annotations

import json
import os
import socketserver
import threading
from contextlib import suppress
from typing import TYPE_CHECKING

from swarmabs_core.errors import RunError
from swarmabs_run.steering.place import SOCKET, short_path
from swarmabs_run.steering.protocol import LONGEST

if TYPE_CHECKING:
    import socket
    from pathlib import Path
    from typing import Any

    from swarmabs_run.steering.request_queue import RequestQueue

MOST_CONNECTIONS = 32
_PART = f"{SOCKET}.part"


class _Connection(socketserver.StreamRequestHandler):
    """Answers line by line, as long as the client speaks."""

    def handle(self) -> None:
        server = self.server
        assert isinstance(server, SteeringServer)  # noqa: S101 - nobody else makes one
        with suppress(ConnectionError):
            while line := self.rfile.readline(LONGEST + 1):
                self.wfile.write(json.dumps(server.requests.ask(line), allow_nan=False).encode() + b"\n")
                if len(line) > LONGEST:  # what follows is the rest of it
                    return


class SteeringServer(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
    """Listens in the folder of a run, in threads of its own.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    requests : RequestQueue
        Who answers.

    Raises
    ------
    RunError
        If the folder cannot hold a socket.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(self, folder: Path, requests: RequestQueue) -> None:
        self.requests = requests
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        try:
            with short_path(folder) as place:
                super().__init__(str(place / _PART), _Connection)
                # It has its name when it listens, and not before: whoever finds it can connect.
                (place / _PART).rename(place / SOCKET)
        except OSError as error:
            raise RunError(
                f"{folder / SOCKET}: {error.strerror}: the folder cannot hold the socket of a run that is steered; "
                "name another with -o"
            ) from error

    def server_bind(self) -> None:
        """Bind; Linux gives the file the permissions that the socket has, so it never has others."""
        os.fchmod(self.socket.fileno(), 0o600)
        super().server_bind()

    def start(self) -> None:
        """Begin to listen."""
        threading.Thread(target=self.serve_forever, name="steering", daemon=True).start()

    def verify_request(self, _request: Any, _client: Any) -> bool:
        """Refuse more connections than there is room for."""
        return self._free.acquire(blocking=False)

    def process_request_thread(self, request: socket.socket | Any, client_address: Any) -> None:
        """Serve a connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()
