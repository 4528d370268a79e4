"""The steering socket: a Unix socket in the folder of the run that only its user can access.

Clients send one JSON object per line and receive an answer to each (docs/how-to/steering.md). Threads read the lines;
only the node's loop uses the steering controller and decides on requests.
"""

from __future__ import annotations

import json
import os
import queue
import socketserver
import threading
from concurrent.futures import Future
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from swarmabs_core.behaviours import Request
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import Action
from swarmabs_run.steering.client import RESTARTS, SOCKET, STATUS, short_path

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable
    from pathlib import Path

    from swarmabs_core.behaviours import Decision, SteeringController
    from swarmabs_core.messages import Messages
    from swarmabs_run.steering.client import Answer

LONGEST = 4096
"""Largest length of a line, bytes."""

VALUED = {"reference": Action.REFERENCE, "disturbance": Action.DISTURBANCE}
"""The actions that set a number."""
ROBOTS = {
    "kill": Action.KILL,
    "freeze": Action.FREEZE,
    "remove": Action.REMOVE,
    "leave": Action.REMOVE,
    "add": Action.ADD,
}
"""The actions that concern a robot; `leave` means removal, the only way for a client to make a robot leave."""
PUSH = "push"
"""The action that adds a torque to the disturbance for `PUSH_SECONDS`."""
PUSH_SECONDS = 0.2
PAUSES = {"pause": True, "resume": False}
"""The actions that pause the run or resume it; nothing of it is recorded."""

MOST_NAMED = 10_000
"""Number of named requests to remember; the oldest are forgotten first."""
MOST_CONNECTIONS = 32
_PART = f"{SOCKET}.part"
_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class SteeringRequest(BaseModel):
    """A request: one line from a client.

    Attributes
    ----------
    action : str
        What to do; ``status`` changes nothing.
    value : float, optional
        For ``reference`` in rad, for ``disturbance`` and ``push`` in N m.
    agent : int, optional
        Id of the robot, for the actions that concern one.
    request : str, optional
        Name that the client chooses. A repeated request with the same name gets the same answer and has no effect.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    action: Literal[
        "reference",
        "disturbance",
        "push",
        "kill",
        "freeze",
        "remove",
        "leave",
        "add",
        "pause",
        "resume",
        "restart",
        "restart_beside",
        "status",
    ]
    value: _Number | None = None
    agent: Annotated[int, Field(ge=1, le=65535)] | None = None
    request: Annotated[str, Field(min_length=1, max_length=100)] | None = None

    @model_validator(mode="after")
    def _check_fields(self) -> SteeringRequest:
        for name, given, actions in (("value", self.value, (*VALUED, PUSH)), ("agent", self.agent, ROBOTS)):
            if (given is not None) != (self.action in actions):
                raise ValueError(f"{self.action} {'needs' if given is None else 'takes no'} '{name}'")
        return self

    def wanted(self, push_steps: int) -> Request:
        """Return the request for the steering controller; a push lasts so many steps."""
        if self.action == PUSH:
            return Request(Action.DISTURBANCE, 0, self.value or 0.0, push_steps)
        if self.action in VALUED:
            return Request(VALUED[self.action], 0, (self.value or 0.0) + 0.0)
        return Request(ROBOTS[self.action], self.agent or 0)


def read_request(line: bytes) -> SteeringRequest:
    """Parse a line; raises `InputError` if it is not a valid request."""
    if len(line) > LONGEST:
        raise InputError(f"the line is longer than {LONGEST} bytes")
    try:
        return SteeringRequest.model_validate_json(line)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"{where}: {first['msg']}" if where else first["msg"]) from error


def refusal(reason: str) -> Answer:
    """Return the answer to a refused request."""
    return {"ok": False, "reason": reason}


class RequestQueue:
    """Accepts lines from any thread; the node's loop answers them.

    The control period is in ns; `facts` are the constant part of the status. `on_decision` is called with every granted
    request for a step, `on_action` with every other action but the status.
    """

    def __init__(
        self,
        controller: SteeringController,
        period_ns: int,
        facts: Answer,
        on_decision: Callable[[Decision], None],
        on_action: Callable[[str], None],
    ) -> None:
        self._controller = controller
        self._period_ns = period_ns
        self._push_steps = max(1, round(PUSH_SECONDS * 1e9 / period_ns))
        self._facts = {**facts, "push_time": self._push_steps * period_ns / 1e9}
        self._on_decision = on_decision
        self._on_action = on_action
        self._inbox: queue.SimpleQueue[tuple[SteeringRequest, Future[Answer]]] = queue.SimpleQueue()
        self._open: dict[int, Future[Answer]] = {}
        self._named: dict[str, tuple[SteeringRequest, Future[Answer]]] = {}

    def ask(self, line: bytes) -> Answer:
        """Return the answer to a line; blocks until the loop has answered it."""
        try:
            asked = read_request(line)
        except InputError as error:
            return refusal(str(error))
        answer: Future[Answer] = Future()
        self._inbox.put((asked, answer))
        return answer.result()

    def work(self) -> Messages:
        """Pass new requests to the controller and answer decided ones; only the loop may call this.

        Return the order that a pause held back, if a request releases it.
        """
        while not self._inbox.empty():
            asked, answer = self._inbox.get()
            self._take(asked, answer)
        released = self._controller.release()
        for decision in self._controller.decisions():
            answer = self._open.pop(decision.number)
            if decision.step is None:
                answer.set_result(refusal(decision.reason))
                continue
            answer.set_result({"ok": True, "request": decision.number, **self._at(decision.step)})
            self._on_decision(decision)
        return released

    def _take(self, asked: SteeringRequest, answer: Future[Answer]) -> None:
        if asked.action == STATUS:
            answer.set_result({"ok": True, **self._status()})
            return
        if asked.request is not None:
            earlier = self._named.get(asked.request)
            if earlier is not None:
                self._repeat(asked, answer, *earlier)
                return
            self._named[asked.request] = (asked, answer)
            if len(self._named) > MOST_NAMED:
                del self._named[next(iter(self._named))]
        try:
            if asked.action in PAUSES:
                self._pause(asked.action, answer)
            elif asked.action in RESTARTS:
                self._restart(asked.action, answer)
            else:
                self._open[self._controller.ask(asked.wanted(self._push_steps))] = answer
        except InputError as error:
            answer.set_result(refusal(str(error)))

    def _pause(self, action: str, answer: Future[Answer]) -> None:
        self._controller.pause(paused=PAUSES[action])
        answer.set_result({"ok": True, **self._at(self._controller.step)})
        self._on_action(action)

    def _restart(self, action: str, answer: Future[Answer]) -> None:
        if not self._facts["restarts"]:
            raise InputError("only a run that was started by 'swarm demo' can start again")
        answer.set_result({"ok": True, **self._at(self._controller.step)})
        self._on_action(action)

    def _at(self, step: int) -> Answer:
        """Return the part of an answer that states a step."""
        return {"step": step, "time": step * self._period_ns / 1e9}

    def _repeat(
        self, asked: SteeringRequest, answer: Future[Answer], first: SteeringRequest, given: Future[Answer]
    ) -> None:
        if asked != first:
            answer.set_result(refusal(f"{asked.request!r} already names a different request; choose another name"))
        else:
            given.add_done_callback(lambda done: answer.set_result(done.result()))

    def _status(self) -> Answer:
        return {
            **self._at(self._controller.step),
            "paused": self._controller.paused,
            "reference": self._controller.setting(Action.REFERENCE),
            "disturbance": self._controller.setting(Action.DISTURBANCE),
            "members": list(self._controller.members),
            "absent": list(self._controller.absent),
            **self._facts,
        }


class _Connection(socketserver.StreamRequestHandler):
    """Answers line by line until the client closes the connection."""

    def handle(self) -> None:
        server = self.server
        assert isinstance(server, SteeringServer)  # noqa: S101 - only the server creates connections
        with suppress(ConnectionError):
            while line := self.rfile.readline(LONGEST + 1):
                self.wfile.write(json.dumps(server.requests.ask(line), allow_nan=False).encode() + b"\n")
                if len(line) > LONGEST:  # the rest of this line follows
                    return


class SteeringServer(socketserver.ThreadingMixIn, socketserver.UnixStreamServer):
    """Listens on a socket in the folder of a run, in threads; raises `RunError` if the folder cannot hold a socket."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, folder: Path, requests: RequestQueue) -> None:
        self.requests = requests
        self._free = threading.BoundedSemaphore(MOST_CONNECTIONS)
        try:
            with short_path(folder) as place:
                super().__init__(str(place / _PART), _Connection)
                # The socket gets its final name only once it listens, so a client that finds it can connect.
                (place / _PART).rename(place / SOCKET)
        except OSError as error:
            raise RunError(
                f"{folder / SOCKET}: {error.strerror}: the folder cannot hold the steering socket; "
                "choose another with -o"
            ) from error

    def server_bind(self) -> None:
        """Bind; Linux gives the file the permissions of the socket, so they are restricted from the start."""
        os.fchmod(self.socket.fileno(), 0o600)
        super().server_bind()

    def start(self) -> None:
        """Start to listen."""
        threading.Thread(target=self.serve_forever, name="steering", daemon=True).start()

    def verify_request(self, _request: object, _client: object) -> bool:
        """Refuse connections beyond the limit."""
        return self._free.acquire(blocking=False)

    def process_request_thread(self, request: socket.socket | tuple[bytes, socket.socket], client_address: str) -> None:
        """Serve a connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()
