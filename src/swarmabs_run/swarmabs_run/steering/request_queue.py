"""Requests to a run, from the socket's threads to the node's loop, which alone uses the steering controller."""

from __future__ import annotations

import queue
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from swarmabs_core.errors import InputError
from swarmabs_core.messages import Action
from swarmabs_run.steering.protocol import STATUS, SteeringRequest, read_request, refusal

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.behaviours import Decision, SteeringController

Answer = dict[str, Any]

MOST_NAMED = 10_000
"""How many named requests are remembered; the oldest are forgotten first."""


class RequestQueue:
    """Takes lines from any thread, and answers them when the node's loop has the time.

    Parameters
    ----------
    controller : SteeringController
        What steers.
    period_ns : int
        Control period, ns.
    facts : dict
        What does not change, for those who ask for the status.
    on_decision : callable
        Told every request that was granted.
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
