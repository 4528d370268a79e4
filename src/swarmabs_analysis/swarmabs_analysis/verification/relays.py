"""Recomputation of what robots that coordinate the swarm by themselves pass on, from what each of them had heard.

Each robot is represented by the state machine that also runs in its process. It receives the recorded relays of its
neighbours, of which the links of the scenario lose the same ones as in the run, and the parent's state if it hears it.
A relay is delivered only once it is confirmed. The first difference is therefore that of the robot that passed on, or
used, what it cannot have known.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import TYPE_CHECKING

from swarmabs_analysis.difference import MESSAGE, Difference, differing_fields, in_hex, judge, surplus
from swarmabs_config import configure
from swarmabs_core.errors import MalformedMessageError, RunError
from swarmabs_core.membership import Membership
from swarmabs_core.messages import ROBOT_STATES, Relay
from swarmabs_core.relays import Content, reduced

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

    from swarmabs_analysis.difference import Value
    from swarmabs_analysis.verification.base import Finding
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.behaviours import Peer
    from swarmabs_core.messages import AnyParentState, AnyRobotState, Message, Messages
    from swarmabs_core.record import Record
    from swarmabs_core.relays import Knowledge

    Heard = Mapping[tuple[int, int], Record]

TIMED = "which relays robots send while one of them is silent depends on time; what these repeat is as recorded"


class RelayVerification:
    """Verifies relays and states of a run in lockstep, step by step from step 0 on.

    Parameters
    ----------
    scenario : Scenario
        One with `coordination: each_robot`.
    tolerance : float
        As for `VerificationResult`, for the numbers of states.
    """

    def __init__(self, scenario: Scenario, tolerance: float) -> None:
        self._tolerance, self._step_ns = tolerance, scenario.step_ns
        robots = configure.members(scenario)
        self._links = configure.links(scenario)
        self._content = Content(robots, scenario.family)
        self._planned = Membership(robots, configure.schedule(scenario))
        self._peers = {peer.agent_id: peer for peer in configure.peers(scenario, robots, recorded=False)}
        self._sent: deque[Relay] = deque()
        self._states: dict[int, dict[int, AnyRobotState]] = {}
        self._before: dict[int, AnyRobotState] = {}
        self._took_part = 0
        self._parent: AnyParentState | None = None
        self._failed = False
        for peer in self._peers.values():
            self._note(peer.start())

    def findings(
        self, step: int, parent: AnyParentState, states: Sequence[Record], relays: Iterable[Record], *, cut: bool
    ) -> Iterator[Finding]:
        """Yield the findings on a step's relays, and the differences of the robots' states from what they had heard.

        Parameters
        ----------
        parent : Message
            The recorded state of the parent.
        states, relays : sequences of Record
            The recorded states and relays, as they are in the bag.
        cut : bool
            Whether the bag is cut off in this step, so that relays may be missing.
        """
        heard = {(relay.agent_id, relay.round): stored for stored in relays if (relay := _relay(stored))}
        open_ = dict(heard)
        while self._sent and not self._failed:
            expected = self._sent.popleft()
            stored = open_.pop((expected.agent_id, expected.round), None)
            if stored is not None:
                yield self._judged(stored, expected, heard)
                for near in self._links.of(expected.agent_id):
                    if near in self._peers:
                        self._ask(self._peers[near], stored.message)
            elif not cut:
                yield _missing(expected)
        if not self._failed:
            yield from (_surplus(stored, step) for stored in open_.values())
        yield from self._used(self._states.pop(step, {}), states)
        self._go_on(step, parent, states, ())

    def timed(
        self,
        step: int,
        parent: AnyParentState,
        states: Sequence[Record],
        relays: Iterable[Record],
        dropped: Collection[int],
    ) -> Iterator[Finding]:
        """Yield the findings as `findings` does, in a step in which it depended on time which relays robots sent.

        Then none is missed, and each of them is only compared with the recorded states that it passes on. The robots
        complete the step with these states, without those that are `dropped`.
        """
        self._sent.clear()
        known = {state.agent_id: reduced(state) for stored in states if (state := _state(stored))}
        for stored in relays:
            yield self._repeated(stored, step, known) or TIMED
        for robot in dropped:
            del self._peers[robot]
        for peer in self._peers.values():
            self._attempt(partial(peer.settle, step, known.values(), self._parent, dropped))
        yield from self._used(self._states.pop(step, {}), states)
        self._go_on(step, parent, states, dropped)

    def _go_on(self, step: int, parent: AnyParentState, states: Iterable[Record], dropped: Iterable[int]) -> None:
        """Let robots hear the parent's state of a step that is verified, so that they begin the next one."""
        for robot, peer in self._peers.items():
            if self._links.senses(robot):
                self._ask(peer, parent)
        self._parent = parent
        self._before = {stored.agent_id: reduced(state) for stored in states if (state := _state(stored))}
        never_join = (robot for robot in dropped if self._planned.span(robot).first > step)
        self._took_part = self._content.set_of((*self._before, *never_join))

    def _used(self, expected: Mapping[int, AnyRobotState], states: Iterable[Record]) -> Iterator[Finding]:
        """Yield the differences of recorded states from those that follow from what the robots had heard."""
        if self._failed:
            return
        for stored in states:
            state = expected.get(stored.agent_id)
            if state is None:
                yield surplus(stored, stored.message.step, "the robot had not heard what this state follows from")
            elif difference := judge(stored, state, self._tolerance):
                yield difference._replace(reason="it does not follow from what the robot had heard")

    def _ask(self, peer: Peer, message: Message) -> None:
        """Let a robot hear a message."""
        self._attempt(partial(peer.handle, message))

    def _attempt(self, act: Callable[[], Messages]) -> None:
        """Let a robot act; a run that fails here ends."""
        if self._failed:
            return
        try:
            self._note(act())
        except RunError:
            self._failed = True

    def _note(self, answers: Iterable[Message]) -> None:
        """Note the relays and states that the bag must contain."""
        for answer in answers:
            if isinstance(answer, Relay):
                self._sent.append(answer)
            elif isinstance(answer, ROBOT_STATES):
                self._states.setdefault(answer.step, {})[answer.agent_id] = answer

    def _judged(self, stored: Record, expected: Relay, heard: Heard) -> Finding:
        recorded = _relay(stored)
        assert recorded is not None  # noqa: S101 - by its topic
        difference = self._told(recorded, expected, heard)
        if difference is not None:
            return difference
        head = judge(stored, expected._replace(content=recorded.content), 0.0, expected.step * self._step_ns)
        return None if head is None else head._replace(reason=_in_round(expected))

    def _repeated(self, stored: Record, step: int, states: Mapping[int, AnyRobotState]) -> Difference | None:
        """Return in what a relay differs from the recorded states that it repeats, None if it does not."""
        relay = _relay(stored)
        assert relay is not None  # noqa: S101 - by its topic
        if relay.agent_id not in self._peers:
            return _surplus(stored, step)
        try:
            said = self._content.read(relay, self._before)
        except MalformedMessageError as error:
            return Difference.of(relay, "content", in_hex(relay.content), "", _in_round(relay, str(error)))
        if said.before != self._took_part:
            there = (self._content.robots_in(said.before), self._content.robots_in(self._took_part))
            return Difference.of(relay, "before", *there, _in_round(relay))
        pairs: list[tuple[str, Message, Message]] = [
            (f"robot_{state.agent_id}", state, states[state.agent_id])
            for state in _sorted(said)
            if state.agent_id in states
        ]
        if said.parent is not None and self._parent is not None:
            pairs.append(("parent", said.parent, self._parent))
        for whose, one, other in pairs:
            for field, ours, theirs in differing_fields(one, other, self._tolerance):
                return Difference.of(relay, f"{whose}.{field}", ours, theirs, _in_round(relay))
        return judge(stored, relay._replace(stamp=step * self._step_ns), 0.0, step * self._step_ns)

    def _told(self, recorded: Relay, expected: Relay, heard: Heard) -> Difference | None:
        """Return in what a recorded content differs from the expected one, None if it does not."""
        if recorded.content == expected.content:
            return None
        due = self._content.read(expected, self._before)
        try:
            said = self._content.read(recorded, self._before)
        except MalformedMessageError as error:
            return _content(recorded, expected, str(error))
        for field, of in (("before", self._told_before), ("held", self._held), ("passed_on", _passed_on)):
            a, b = of(said), of(due)
            if a != b:
                unheard = sorted({*a} - {*self._held(due)})
                reason = self._unheard(unheard[0], expected, heard) if unheard else ""
                return Difference.of(expected, field, a, b, _in_round(expected, reason))
        pairs: list[tuple[str, Message, Message]] = [
            (f"robot_{one.agent_id}", one, other) for one, other in zip(_sorted(said), _sorted(due), strict=True)
        ]
        if said.parent is not None and due.parent is not None:
            pairs.append(("parent", said.parent, due.parent))
        elif said.parent is not due.parent:
            there = [None if told.parent is None else told.parent._asdict() for told in (said, due)]
            return Difference.of(expected, "parent", there[0] or "none", there[1] or "none", _in_round(expected))
        for whose, one, other in pairs:
            for field, ours, theirs in differing_fields(one, other, self._tolerance):
                return Difference.of(expected, f"{whose}.{field}", ours, theirs, _in_round(expected))
        return None if self._tolerance and said.votes == due.votes else _content(recorded, expected)

    def _told_before(self, told: Knowledge) -> tuple[int, ...]:
        return self._content.robots_in(told.before)

    def _held(self, told: Knowledge) -> tuple[int, ...]:
        return self._content.robots_in(told.held)

    def _unheard(self, robot: int, expected: Relay, heard: Heard) -> str:
        """Return why the sender of a relay cannot have heard the state of another robot."""
        receiver, step = expected.agent_id, expected.step
        problem = f"it cannot have heard the state of robot {robot}: "
        for number in range(expected.round):
            for near in self._links.of(receiver):
                relay = _relay(heard.get((near, number)))
                if relay is None or robot not in _passed_on(self._content.read(relay, self._before)):
                    continue
                if self._links.loses(step, number, near, receiver):
                    return f"{problem}the link lost the relay of robot {near} in round {number}"
        return f"{problem}no neighbour has passed it on"


def _relay(stored: Record | None) -> Relay | None:
    return stored.message if stored is not None and isinstance(stored.message, Relay) else None


def _state(stored: Record) -> AnyRobotState | None:
    return stored.message if isinstance(stored.message, ROBOT_STATES) else None


def _sorted(told: Knowledge) -> list[AnyRobotState]:
    return sorted(told.states, key=lambda state: state.agent_id)


def _passed_on(told: Knowledge) -> tuple[int, ...]:
    return tuple(state.agent_id for state in _sorted(told))


def _in_round(relay: Relay, reason: str = "") -> str:
    return f"round {relay.round}{reason and ': '}{reason}"


def _content(recorded: Relay, expected: Relay, reason: str = "") -> Difference:
    told = (in_hex(recorded.content), in_hex(expected.content))
    return Difference.of(expected, "content", *told, _in_round(expected, reason))


def _fields(relay: Relay) -> Value:
    return relay._asdict() | {"content": in_hex(relay.content)}


def _missing(expected: Relay) -> Difference:
    return Difference.of(expected, MESSAGE, None, _fields(expected), _in_round(expected))


def _surplus(stored: Record, step: int) -> Difference:
    relay = _relay(stored)
    assert relay is not None  # noqa: S101 - by its topic
    reason = _in_round(relay, "nothing that the robot had heard leads to it")
    return Difference.of(relay, MESSAGE, _fields(relay), None, reason)._replace(step=step)
