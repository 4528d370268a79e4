"""Between the socket's threads, which bring what people ask for, and the node's loop, which alone moves the helm."""

from __future__ import annotations

import queue
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

from swarmabs_core.errors import InputError
from swarmabs_core.messages import Action
from swarmabs_run.steering.protocol import STATUS, Wish, read_wish, refusal

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.behaviours import Decision, Helm

Answer = dict[str, Any]

MOST_NAMED = 10_000
"""How many named requests are remembered; the oldest are forgotten first."""


class Desk:
    """Takes lines from any thread, and answers them when the node's loop has the time.

    Parameters
    ----------
    helm : Helm
        What steers.
    period_ns : int
        Control period, ns.
    facts : dict
        What does not change, for those who ask for the status.
    on_decision : callable
        Told every request that was granted.
    """

    def __init__(self, helm: Helm, period_ns: int, facts: Answer, on_decision: Callable[[Decision], None]) -> None:
        self._helm = helm
        self._period_ns = period_ns
        self._facts = facts
        self._on_decision = on_decision
        self._inbox: queue.SimpleQueue[tuple[Wish, Future[Answer]]] = queue.SimpleQueue()
        self._open: dict[int, Future[Answer]] = {}
        self._named: dict[str, tuple[Wish, Future[Answer]]] = {}

    def ask(self, line: bytes) -> Answer:
        """Answer a line; waits until the loop has done so."""
        try:
            wish = read_wish(line)
        except InputError as error:
            return refusal(str(error))
        answer: Future[Answer] = Future()
        self._inbox.put((wish, answer))
        return answer.result()

    def work(self) -> None:
        """Hand what was asked for to the helm, and tell what has become of earlier requests; for the loop alone."""
        while not self._inbox.empty():
            wish, answer = self._inbox.get()
            self._take(wish, answer)
        for decision in self._helm.decisions():
            answer = self._open.pop(decision.number)
            if decision.step is None:
                answer.set_result(refusal(decision.reason))
                continue
            time = decision.step * self._period_ns / 1e9
            answer.set_result({"ok": True, "request": decision.number, "step": decision.step, "time": time})
            self._on_decision(decision)

    def _take(self, wish: Wish, answer: Future[Answer]) -> None:
        if wish.action == STATUS:
            answer.set_result({"ok": True, **self._status()})
            return
        if wish.request is not None:
            known = self._named.get(wish.request)
            if known is not None:
                self._repeat(wish, answer, *known)
                return
            self._named[wish.request] = (wish, answer)
            if len(self._named) > MOST_NAMED:
                del self._named[next(iter(self._named))]
        try:
            self._open[self._helm.ask(wish.wanted())] = answer
        except InputError as error:
            answer.set_result(refusal(str(error)))

    def _repeat(self, wish: Wish, answer: Future[Answer], first: Wish, given: Future[Answer]) -> None:
        if wish != first:
            answer.set_result(refusal(f"request {wish.request!r} was something else before; choose another name"))
        else:
            given.add_done_callback(lambda done: answer.set_result(done.result()))

    def _status(self) -> Answer:
        return {
            "step": self._helm.step,
            "time": self._helm.step * self._period_ns / 1e9,
            "reference": self._helm.setting(Action.REFERENCE),
            "disturbance": self._helm.setting(Action.DISTURBANCE),
            "members": list(self._helm.members),
            "absent": list(self._helm.absent),
            **self._facts,
        }
