"""All properties of virtual fleets, and who tells them what happens."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.virtual.coordinators import COORDINATORS
from tests.virtual.fleet import Parcel, Watcher
from tests.virtual.peers import STATEMENTS as OF_PEERS, TellEachOther
from tests.virtual.properties import (
    ActsOnOneSet,
    AnswersThePlane,
    Ending,
    Facts,
    KeepsFollowing,
    KeepsSpeaking,
    NoStepTwice,
    OneLeads,
    Property,
    ReportsSparingly,
    StaysInItsLane,
    SumsUpWhatItHears,
)

from swarmabs_core.messages import Message, Topic

PROPERTIES: tuple[type[Property], ...] = (
    ActsOnOneSet,
    KeepsFollowing,
    KeepsSpeaking,
    OneLeads,
    SumsUpWhatItHears,
    AnswersThePlane,
    NoStepTwice,
    StaysInItsLane,
    ReportsSparingly,
    *COORDINATORS,
)


class Checks(Watcher):
    """Hands on to the properties what happens; `peers` is that of robots without coordinators."""

    def __init__(self, facts: Facts) -> None:
        self._facts = facts
        self.peers = TellEachOther(facts) if facts.case.each_robot else None
        self._properties = [*(of(facts) for of in PROPERTIES), *([] if self.peers is None else [self.peers])]
        self._published: dict[Topic, list[Callable[[str, Any], None]]] = {}
        self._heard: dict[Topic, list[Callable[[str, Parcel], None]]] = {}
        self._periods = [one.period for one in self._properties if type(one).period is not Property.period]
        for one in self._properties:
            for topic, said in one.published.items():
                self._published.setdefault(topic, []).append(said)
            for topic, heard in one.heard.items():
                self._heard.setdefault(topic, []).append(heard)

    def begins(self, node: str) -> None:
        self._facts.starts(node)
        for one in self._properties:
            one.begins(node)

    def resumes(self, node: str) -> None:
        for one in self._properties:
            one.resumes(node)

    def told(self, node: str, command: str) -> None:
        for one in self._properties:
            one.told(node, command)

    def published(self, node: str, topic: Topic, message: Message, data: bytes) -> None:
        for said in self._published.get(topic, ()):
            said(node, message)

    def heard(self, node: str, parcel: Parcel) -> None:
        for heard in self._heard.get(parcel.topic, ()):
            heard(node, parcel)

    def period(self) -> None:
        """Note that a period is nearly over."""
        for over in self._periods:
            over()


STATEMENTS = {one.name: one.statement for one in (*PROPERTIES, Ending)} | {
    "STOP wins": "After a STOP that a controller has accepted and passed on, no robot moves until an operator resets.",
    "memory is bounded": "What a node keeps does not grow with the time or with what others send to it.",
    "bags survive": "A bag has nothing that its recorder has not heard; after a repair it has all that must survive.",
    "bags are merged": "A merged bag has each message of its bags once, in order, whatever the order of the bags is.",
    "losses are counted": "Figures, repairs and merges count and name exactly what a bag has and lacks.",
    "bags are explained": "Every message in a bag follows from those before it, also after a repair and when merged.",
    "a start ends": "A run starts, or fails and says who is missing; nobody waits for ever.",
    "a start is complete": "No process is told to start before all are ready and have met their counterparts.",
    "nothing remains": "When a run is over, each process that was started has ended and is reaped; no pipe is open.",
    "an outcome is right": "A run goes on where it can; its outcome says what happened, and names who failed.",
    "lockstep goes on": "A run in lockstep ends, whatever the transport does, unless a node is lost for good.",
    "equal digests": "Every message of a run in lockstep is, bit for bit, that of the simulation in one process.",
    "comes to rest": "A robot whose node is deactivated stops at once.",
    "no node fails": "No node ends with an exception, whatever it hears.",
    **OF_PEERS,
}
"""What each property means, for people."""
