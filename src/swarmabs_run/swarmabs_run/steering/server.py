"""The socket of a run that is steered: a Unix socket in the folder of the run, for its user alone.

Clients send JSON objects in lines and get an answer to each (docs/how-to/steering.md). Threads read them; the node's
loop, which alone uses the steering controller, decides.
"""

from __future__ import annotations

import json
import os
import queue
import socketserver
import threading
from concurrent.futures import Future
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from swarmabs_core.behaviours import Request
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import Action
from swarmabs_run.steering.client import SOCKET, STATUS, short_path

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable
    from pathlib import Path

    from swarmabs_core.behaviours import Decision, SteeringController

Answer = dict[str, Any]

LONGEST = 4096
"""Longest line, bytes."""

VALUED = {"reference": Action.REFERENCE, "disturbance": Action.DISTURBANCE}
"""The actions that set a number."""
ROBOTS = {
    "kill": Action.KILL,
    "freeze": Action.FREEZE,
    "remove": Action.REMOVE,
    "leave": Action.REMOVE,
    "add": Action.ADD,
}
"""The actions that concern a robot; from outside a robot can only be removed, so that is what `leave` is."""

MOST_NAMED = 10_000
"""How many named requests are remembered; the oldest are forgotten first."""
MOST_CONNECTIONS = 32
_PART = f"{SOCKET}.part"
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class SteeringRequest(BaseModel):
    """One line: what somebody asks for.

    Attributes
    ----------
    action : str
        What is to be done; ``status`` only asks.
    value : float, optional
        Of ``reference`` in rad, of ``disturbance`` in N m.
    agent : int, optional
        The robot, for the others.
    request : str, optional
        What the client calls it. Who asks again under the same name gets the same answer, and nothing is done twice.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    action: Literal["reference", "disturbance", "kill", "freeze", "remove", "leave", "add", "status"]
    value: _Number | None = None
    agent: Annotated[int, Field(ge=1, le=65535)] | None = None
    request: Annotated[str, Field(min_length=1, max_length=100)] | None = None

    @model_validator(mode="after")
    def _check_fields(self) -> SteeringRequest:
        for name, given, actions in (("value", self.value, VALUED), ("agent", self.agent, ROBOTS)):
            if (given is not None) != (self.action in actions):
                raise ValueError(f"{self.action} {'needs' if given is None else 'takes no'} '{name}'")
        return self

    def wanted(self) -> Request:
        """Return it as what steers the run takes it."""
        if self.action in VALUED:
            return Request(VALUED[self.action], 0, (self.value or 0.0) + 0.0)
        return Request(ROBOTS[self.action], self.agent or 0)


def read_request(line: bytes) -> SteeringRequest:
    """Read a line; an `InputError` says why it is not a valid one."""
    if len(line) > LONGEST:
        raise InputError(f"the line is longer than {LONGEST} bytes")
    try:
        return SteeringRequest.model_validate_json(line)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"{where}: {first['msg']}" if where else first["msg"]) from error


def refusal(reason: str) -> dict[str, Any]:
    """Return the answer to what is not done."""
    return {"ok": False, "reason": reason}


class RequestQueue:
    """Takes lines from any thread, and answers them when the node's loop has the time.

    The control period is in ns; `facts` are what does not change, for those who ask for the status. Every request that
    was granted is told to `on_decision`.
    """

    def __init__(
        self, controller: SteeringController, period_ns: int, facts: Answer, on_decision: Callable[[Decision], None]
    ) -> None:
        self._controller = controller
        self._period_ns = period_ns
        self._facts = facts
        self._on_decision = on_decision
        self._inbox: queue.SimpleQueue[tuple[SteeringRequest, Future[Answer]]] = queue.SimpleQueue()
        self._open: dict[int, Future[Answer]] = {}
        self._named: dict[str, tuple[SteeringRequest, Future[Answer]]] = {}

    def ask(self, line: bytes) -> Answer:
        """Answer a line; waits until the loop has done so."""
        try:
            asked = read_request(line)
        except InputError as error:
            return refusal(str(error))
        answer: Future[Answer] = Future()
        self._inbox.put((asked, answer))
        return answer.result()

    def work(self) -> None:
        """Hand what was asked for to the controller, and answer earlier requests; for the loop alone."""
        while not self._inbox.empty():
            asked, answer = self._inbox.get()
            self._take(asked, answer)
        for decision in self._controller.decisions():
            answer = self._open.pop(decision.number)
            if decision.step is None:
                answer.set_result(refusal(decision.reason))
                continue
            time = decision.step * self._period_ns / 1e9
            answer.set_result({"ok": True, "request": decision.number, "step": decision.step, "time": time})
            self._on_decision(decision)

    def _take(self, asked: SteeringRequest, answer: Future[Answer]) -> None:
        if asked.action == STATUS:
            answer.set_result({"ok": True, **self._status()})
            return
        if asked.request is not None:
            known = self._named.get(asked.request)
            if known is not None:
                self._repeat(asked, answer, *known)
                return
            self._named[asked.request] = (asked, answer)
            if len(self._named) > MOST_NAMED:
                del self._named[next(iter(self._named))]
        try:
            self._open[self._controller.ask(asked.wanted())] = answer
        except InputError as error:
            answer.set_result(refusal(str(error)))

    def _repeat(
        self, asked: SteeringRequest, answer: Future[Answer], first: SteeringRequest, given: Future[Answer]
    ) -> None:
        if asked != first:
            answer.set_result(refusal(f"request {asked.request!r} was something else before; choose another name"))
        else:
            given.add_done_callback(lambda done: answer.set_result(done.result()))

    def _status(self) -> Answer:
        return {
            "step": self._controller.step,
            "time": self._controller.step * self._period_ns / 1e9,
            "reference": self._controller.setting(Action.REFERENCE),
            "disturbance": self._controller.setting(Action.DISTURBANCE),
            "members": list(self._controller.members),
            "absent": list(self._controller.absent),
            **self._facts,
        }


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
    """Listens in the folder of a run, in threads of its own; raises `RunError` if the folder cannot hold a socket."""

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
