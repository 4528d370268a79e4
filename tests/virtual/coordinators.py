"""What must hold for observers and parent controllers, and for what robots do when they are told to stop or to leave.

As in properties.py, the rules follow from docs/explanation/safety.md and standby.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import inf
from typing import Any

from tests.virtual.fleet import EPOCH, Parcel
from tests.virtual.properties import LONG_AGO, Facts, Property, variants
from tests.virtual.schedule import LINKS, RESET_LASTS, TAKEOVER

from swarmabs_config.graph import PLANE
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    BASIS,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    NEVER,
    PLANE_STATE,
    AgentState,
    Basis,
    EventKind,
    Kind,
    Mode,
    Source,
    Status,
    SwarmEvent,
)
from swarmabs_core.nodes import agent_name
from swarmabs_core.realtime.base import Level

AGREED = 10
"""Periods in a row in which a standby must hear its primary before it yields."""
LISTENS = (1.0, 2.0)
"""Time, s, for which a primary and a standby listen when they start."""
PROMPT = 2
"""Largest age, periods, of a message that is heard without delay."""
LEAVING = 10
"""Periods for which a robot that leaves says so."""
BRAKING_TIME = 0.1
"""Time constant, s, with which a force-driven robot comes to rest."""


class _Instance:
    """One of a pair: what has reached it since it started, and when it spoke; in steps of its clock."""

    def __init__(self) -> None:
        self.peer = LONG_AGO
        self.writer = b""
        self.changed = LONG_AGO
        self.robots = LONG_AGO
        self.inputs: list[int] = []
        self.members: set[int] = set()
        self.modes: set[int] = set()
        self.spoke = LONG_AGO
        self.began = LONG_AGO
        self.prompt = 0
        self.most_prompt = 0
        self.released = LONG_AGO


class TakesTurns(Property):
    """One of a pair begins to speak when the other one is silent, neither before nor much later, and yields by rule."""

    name = "takes turns"
    statement = (
        "One of a pair of coordinators begins to speak once the other one has been silent for longer than "
        "takeover_after and it could have spoken itself, two steps later at most; it listens first when it starts (the "
        f"primary for {LISTENS[0]:g} s, the standby for {LISTENS[1]:g} s) and when it has stood still for longer than "
        "takeover_after (for as long, the standby for twice as long); it is silent after a release, and if it hears no "
        f"robot; a standby yields to a primary that it has heard for {AGREED} steps, and not before."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._instances: dict[str, _Instance] = {}
        self._ordered_at = float("-inf")
        if not facts.case.paired:
            return
        self._takeover = TAKEOVER
        deceived = {fault.who for fault in facts.case.faults if fault.kind == "impostor"}
        self._peers = {a: b for pair in facts.case.pairs for a, b in (pair, pair[::-1])}
        self._instances = {name: _Instance() for name in self._peers if name not in deceived}
        self.published = {ABSTRACT_STATE: self._says, DESIRED_ABSTRACT_STATE: self._says, EVENTS: self._event}
        self.heard = {topic: self._peer for of in (ABSTRACT_STATE, DESIRED_ABSTRACT_STATE) for topic in variants(of)}
        self.heard |= dict.fromkeys(variants(AGENT_STATE), self._robot)
        self.heard[PLANE_STATE] = self._plane

    def begins(self, node: str) -> None:
        if node in self._instances:
            self._instances[node] = _Instance()

    def told(self, node: str, command: str) -> None:
        one = self._instances.get(node)
        if one is None:
            return
        step = self.facts.step_of(node)
        if command == "release" and step - one.spoke <= 1:
            one.peer, one.released, one.prompt = LONG_AGO, step, 0
        elif command in {"stop", "reset"}:
            self._ordered_at = self.facts.now

    def _peer(self, node: str, parcel: Parcel) -> None:
        one = self._instances.get(node)
        if one is None or parcel.message is None or (parcel.sender and parcel.sender != self._peers[node]):
            return
        step = self.facts.step_of(node)
        if parcel.writer != one.writer:  # also one who forges may be bound in the silence of the peer
            one.writer, one.changed = parcel.writer, step
        if not parcel.sender:
            return
        if getattr(parcel.message, "mode", Mode.RUN) != Mode.RUN:
            self._ordered_at = self.facts.now
        if parcel.message.step <= step + self.facts.ahead:
            one.peer = max(one.peer, parcel.message.step)

    def _robot(self, node: str, parcel: Parcel) -> None:
        one, state = self._instances.get(node), parcel.message
        if (
            one is not None
            and isinstance(state, AgentState)
            and state.step <= self.facts.step_of(node) + self.facts.ahead
        ):
            one.robots = max(one.robots, state.step)
            one.members.add(state.agent_id)
            self._input(node, one)

    def _plane(self, node: str, parcel: Parcel) -> None:
        if (one := self._instances.get(node)) is not None and node in self.facts.case.pairs[1]:
            self._input(node, one)

    def _input(self, node: str, one: _Instance) -> None:
        step = self.facts.step_of(node)
        if not one.inputs or step != one.inputs[-1]:
            one.inputs.append(step)
            del one.inputs[: -2 * AGREED]

    def _event(self, node: str, event: SwarmEvent) -> None:
        """Check who begins to speak."""
        one = self._instances.get(node)
        if event.kind != EventKind.LEADING or one is None or node in self.facts.wrong:
            return
        step = self.facts.step_of(node)
        self._begins_to_speak(node, one, step)
        self._could_speak(node, one, step)

    def _begins_to_speak(self, node: str, one: _Instance, step: int) -> None:
        """Check that one that has not spoken for longer than a takeover takes may speak."""
        facts, listens = self.facts, LISTENS[node in {pair[1] for pair in self.facts.case.pairs}]
        if step - one.peer <= self._takeover and step - one.changed > 2 * facts.age:
            text = f"begins to lead in step {step}, but has heard {self._peers[node]} in step {one.peer}"
            raise self.broken(node, f"{text}; it has to be silent for more than {self._takeover}")
        running = facts.now - facts.runs_since(node) if facts.runs_since(node) == facts.started[node] else inf
        if one.peer == one.released == LONG_AGO and running < listens * 1e9 - 2 * facts.period:
            raise self.broken(node, f"leads {running / 1e9:.3f} s after its start, and has to listen for {listens:g} s")

    @property
    def _is_ordered(self) -> bool:
        """Whether there was a STOP or a RESET a short while ago, which a controller repeats whatever it hears."""
        return self.facts.now - self._ordered_at < 1.5e9

    def _could_speak(self, node: str, one: _Instance, step: int) -> None:
        """Check that a standby that takes over has heard what it needs for as long as the other one was silent."""
        if self._is_ordered or node not in {standby for _, standby in self.facts.case.pairs}:
            return
        since, gap = step, self._takeover + self.facts.state_age
        for heard in one.inputs[::-1]:
            if since - heard > gap:
                break
            since = heard
        if step - since < self._takeover:
            text = f"begins to lead in step {step}, but has been able to since step {since} only"
            raise self.broken(node, f"{text}; it has to be for {self._takeover}")

    def _says(self, node: str, message: Any) -> None:
        one, facts = self._instances.get(node), self.facts
        if one is None:
            return
        mode, step = getattr(message, "mode", Mode.RUN), facts.step_of(node)
        if mode != Mode.RUN:
            self._ordered_at = facts.now
            one.spoke = step if mode == Mode.RESET else one.spoke  # a silent one repeats STOP, too
            return
        if node in facts.wrong:
            return
        # What came late from before the release looks like a peer that speaks and falls silent.
        late = 0 <= one.peer <= one.released
        if step - one.released < self._takeover and not late:
            raise self.broken(node, f"publishes step {message.step}, although it was released in step {one.released}")
        if node in facts.case.pairs[0] and step - one.robots > facts.state_age:
            heard = "none" if one.robots == LONG_AGO else f"the last one in step {one.robots}"
            raise self.broken(node, f"publishes sums of step {message.step}, but hears no robot: {heard}")
        resumed = facts.clock.step(EPOCH + facts.resumed.get(node, 0))
        if facts.stood.get(node, 0) > (self._takeover + 2) * facts.period and step - resumed < self._takeover:
            text = f"publishes step {message.step}, but has stood still until step {resumed}"
            raise self.broken(node, f"{text}, and has to listen for {self._takeover} steps")
        if step > one.spoke:
            if step - one.spoke > 1:
                one.began = step
            if step - one.spoke > self._takeover + 1:
                self._begins_to_speak(node, one, step)
            one.prompt = one.prompt + 1 if step - one.spoke == 1 and step - one.peer <= PROMPT else 0
            one.most_prompt = one.prompt
            one.spoke = step
        pair = facts.case.pairs[int(node in facts.case.pairs[1])]
        known = step - one.changed > facts.age + AGREED + 2  # one that restarts is refused while it was heard before
        if node == pair[1] and one.prompt > AGREED + 2 and known:
            text = f"publishes step {message.step}, but has heard {pair[0]} without delay for {one.prompt} periods"
            raise self.broken(node, text)

    def period(self) -> None:
        """Check who should speak."""
        facts = self.facts
        if facts.late_until > facts.now or facts.moving_from > facts.now or self._is_ordered:
            return
        for node, one in self._instances.items():
            if facts.runs_since(node) > facts.now - facts.settles or node in facts.wrong:
                continue
            step = facts.step_of(node)
            self._check_silence(node, one, step)

    def _check_silence(self, node: str, one: _Instance, step: int) -> None:
        needed, takeover = 2 * self._takeover + 4, self._takeover
        hears = len([k for k in one.inputs if k > step - needed - AGREED]) >= needed + AGREED - 1
        waits = node in self.facts.case.pairs[0] and len(one.members) < self.facts.case.robots
        if not hears or waits or step - one.spoke <= 2 or step - one.released <= 3 * takeover:
            return
        peer = self._peers[node]
        if step - one.peer > takeover + 3:
            text = f"is silent since step {max(0, one.spoke)}, and has not heard {peer} since step {max(0, one.peer)}"
            raise self.broken(node, f"in step {step} {text}")
        stopped = 2 < step - one.spoke <= takeover and one.spoke - one.began > 2 * AGREED
        if not stopped:
            return
        if node in {pair[0] for pair in self.facts.case.pairs}:
            raise self.broken(
                node, f"has led, and is silent since step {one.spoke}, although nothing has happened to it"
            )
        if one.most_prompt < AGREED - 2:
            text = f"has led, and is silent since step {one.spoke}: it yields after {one.most_prompt} periods"
            raise self.broken(node, f"{text} in which it has heard {peer}")


class TellsWhoCounts(Property):
    """The events of an observer say what changes in whom it counts."""

    name = "tells who counts"
    statement = (
        "An observer reports DEAD, JOINED and LEFT of just those robots which fall silent, are heard again or are gone "
        "in the provenance of its sums; what one of a pair has seen while neither spoke is reported later."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._before: dict[str, tuple[int, dict[int, int]] | None] = {}
        if facts.case.each_robot:
            return
        self._events: dict[str, set[tuple[int, int]]] = {}
        self._joined: set[int] = set()
        self._known: dict[str, set[int]] = {}
        # What one of a pair has seen while the other one spoke, that one may not have heard.
        self._all_hear = not any(fault.kind in LINKS for fault in facts.case.faults)
        self._before = dict.fromkeys(facts.case.pairs[0])
        self.published = {BASIS: self._basis, EVENTS: self._event}

    def begins(self, node: str) -> None:
        if node in self._before:
            self._before[node] = None
            self._events[node] = set()
            self._known[node] = set()

    resumes = begins

    def _event(self, node: str, event: SwarmEvent) -> None:
        if node in self._before:
            if event.kind == EventKind.LEADING:
                self._before[node] = None  # events of the time before are told now
            elif event.kind in {EventKind.DEAD, EventKind.JOINED, EventKind.LEFT}:
                self._events[node].add((event.agent_id, event.kind))
                self._joined |= {event.agent_id} if event.kind == EventKind.JOINED else set()

    def _basis(self, node: str, basis: Basis) -> None:
        if basis.source != Source.OBSERVER:
            return
        counted = dict(zip(basis.agent_ids, basis.standing, strict=True))
        before, told = self._before[node], self._events[node]
        for robot, stands in counted.items():
            if not stands and robot not in self._joined and self._all_hear:
                raise self.broken(
                    node, f"counts robot {robot} in step {basis.step}, and nobody has reported JOINED of it"
                )
        if before is not None and basis.step == before[0] + 1:
            due = set(_changes(before[1], counted))
            unknown = {(robot, EventKind.LEFT) for robot, _ in told if robot not in self._known[node]}
            for robot, kind in sorted((due ^ told) - unknown):  # that it has left may be the first that is heard of it
                what = "does not report" if (robot, kind) in due else "reports, although nothing changes,"
                raise self.broken(node, f"{what} in step {basis.step} of robot {robot}: {EventKind(kind).name}")
        self._before[node] = basis.step, counted
        self._known[node] |= {*counted, *(robot for robot, _ in told)}
        self._events[node] = set()


def _changes(before: dict[int, int], after: dict[int, int]) -> Iterator[tuple[int, int]]:
    """Yield robot and kind of the events that tell how those who count change; 1 is for a silent robot."""
    for robot in before.keys() | after.keys():
        was, now = before.get(robot), after.get(robot)
        if was != now:
            yield robot, EventKind.LEFT if now is None else EventKind.DEAD if now else EventKind.JOINED


class RestsAndLeaves(Property):
    """A robot that does not follow comes to rest, and one that leaves says so and is silent."""

    name = "rests and leaves"
    statement = (
        "A robot that does not follow commands 0, or if it is driven by a force its brake, by a fresh measurement; one "
        f"that is told to leave rests, says so for {LEAVING} periods, then is silent until it is told to join."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._before: dict[str, AgentState | None] = dict.fromkeys(facts.case.robot_names)
        self._left: dict[str, tuple[int, int]] = {}
        self._rested: set[str] = set()
        self._ages: dict[str, int] = {}
        self._time = max(BRAKING_TIME, facts.clock.period)
        self.published = {AGENT_STATE: self._state}

    def begins(self, node: str) -> None:
        if node in self._before:
            self._before[node] = None
            self._left.pop(node, None)

    def resumes(self, node: str) -> None:
        if node in self._before:
            self._before[node] = None

    def told(self, node: str, command: str) -> None:
        if command == "leave":
            self._left.setdefault(node, (0, self.facts.now))
            self._rested.add(node)
        elif command == "join":
            self._left.pop(node, None)

    def _state(self, node: str, state: AgentState) -> None:
        before, self._before[node] = self._before[node], state
        age, self._ages[node] = self._ages.get(node, 0), self.facts.fleet.now(node) - state.stamp
        if node in self._left:
            said, since = self._left[node]
            self._left[node] = said + 1, since
            if said >= LEAVING:
                text = f"speaks in step {state.step}, the {said + 1}th time since it was told to leave"
                raise self.broken(node, text)
        if (state.status == Status.LEFT) != (node in self._left):
            told = "was told to leave" if node in self._left else "was not told to leave"
            raise self.broken(node, f"says {Status(state.status).name} in step {state.step}, and {told}")
        if before is None:
            if state.command != 0.0 or state.status == Status.ACTIVE:
                raise self.broken(node, f"begins with {Status(state.status).name} and the command {state.command:.9g}")
            return
        if state.broadcast_step == NEVER:
            self._rests(node, before, state, age)
        if node not in self._left:
            self._rested.discard(node)
        moved = state.position - before.position
        regular = state.step == before.step + 1 and node not in self.facts.odd
        if (
            state.kind == Kind.SINGLE_INTEGRATOR
            and regular
            and abs(moved - state.command * self.facts.clock.period) > 1e-9
        ):
            text = f"moves by {moved:.9g} m in step {state.step} with the command {state.command:.9g} m/s"
            raise self.broken(node, text)

    def _rests(self, node: str, before: AgentState, state: AgentState, age: int) -> None:
        """Check the command of a robot that follows nothing; `age` is that of its measurement before, ns."""
        brake = 0.0 if state.kind == Kind.SINGLE_INTEGRATOR else -state.mass * before.velocity / self._time
        if brake and state.command and age > self.facts.measurement_age:
            text = f"brakes in step {before.step} by a velocity that it measured {age / 1e9:.3f} s before"
            raise self.broken(node, text)
        if abs(state.command - brake) <= 1e-12 or (state.command == 0.0 and not self._brakes(node, before)):
            return
        status = Status(state.status).name
        text = (
            f"follows nothing in step {before.step} ({status}), and commands {state.command:.9g}; to rest: {brake:.9g}"
        )
        raise self.broken(node, text)

    def _brakes(self, node: str, before: AgentState) -> bool:
        """Return whether a robot with a force knows its velocity, and so has to brake."""
        return node not in self.facts.odd and node not in self._rested and before.status != Status.LEFT

    def period(self) -> None:
        """Check that one which leaves says so long enough."""
        facts = self.facts
        for node, (said, since) in self._left.items():
            lasting = (facts.now - since) // facts.period
            if said < min(lasting - 1, LEAVING) and facts.runs_since(node) <= since and node not in facts.odd:
                raise self.broken(node, f"was told to leave {lasting} periods ago, and has said so {said} times")


class SpeaksOfOrders(Property):
    """A controller publishes STOP and RESET as long as it has to, and begins anew after a RESET."""

    name = "publishes orders"
    statement = (
        "A controller that is told to stop publishes STOP at once, and in every period until a reset, unless its peer "
        f"does; one that is told to reset publishes RESET for {RESET_LASTS:g} s before RUN, and its law begins anew; "
        "one that takes over from its peer continues the law of the peer. A fleet that starts in STOP does not move "
        "before a reset; one of a pair is silent until it is told or hears its peer."
    )

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._told: dict[str, tuple[str, int]] = {}
        self._said: dict[tuple[str, int], int] = {}
        self._restarts: dict[str, int] = {}
        self._heard_stop: dict[str, int] = {}
        self._aware: set[str] = set()
        self._laws: dict[str, Basis] = {}
        self._answered: dict[str, int] = {}
        self._reset_told = not facts.case.stopped
        self._reset_at = LONG_AGO
        if facts.case.each_robot:
            return
        self.published = {DESIRED_ABSTRACT_STATE: self._says, BASIS: self._basis, AGENT_STATE: self._moves}
        self.heard = dict.fromkeys(variants(DESIRED_ABSTRACT_STATE), self._peer)
        self.heard |= dict.fromkeys(variants(BASIS), self._law)

    def begins(self, node: str) -> None:
        self._laws.pop(node, None)
        self._told.pop(node, None)
        self._restarts.pop(node, None)
        self._aware.discard(node)

    def resumes(self, node: str) -> None:
        self._laws.pop(node, None)  # with a deactivation its own began anew

    def told(self, node: str, command: str) -> None:
        facts = self.facts
        if command not in {"stop", "reset"} or facts.case.each_robot:  # robots without a controller pass orders on
            return
        self._told[node] = command, facts.now
        self._aware.add(node)
        if command == "reset":
            self._reset_told, self._reset_at = True, facts.now
            if not facts.case.paired or self._speaks(node, Mode):
                self._restarts[node] = facts.step_of(node)

    def _peer(self, node: str, parcel: Parcel) -> None:
        """Note what one of a pair knows from the other; the law of one that stands by begins anew with a RESET."""
        if node not in self.facts.case.pairs[1] or not parcel.sender or parcel.message is None:
            return
        self._aware.add(node)
        if parcel.message.mode == Mode.STOP:  # type: ignore[union-attr]
            self._heard_stop[node] = self.facts.now
        stands_by = self.facts.now - self._said.get((node, Mode.RUN), LONG_AGO) > 2 * self.facts.settles
        if parcel.message.mode == Mode.RESET and stands_by and self.facts.is_fine(node):  # type: ignore[union-attr]
            self._restarts[node] = min(self._restarts.get(node, 2**62), parcel.message.step)

    def _law(self, node: str, parcel: Parcel) -> None:
        """Note the law of the peer, which one that leads in RUN does not take over."""
        basis = parcel.message
        if not parcel.sender or not isinstance(basis, Basis) or basis.source != Source.CONTROLLER:
            return
        if not self._speaks(node, [Mode.RUN]):
            self._laws[node] = basis

    def _speaks(self, node: str, modes: Iterable[Mode]) -> bool:
        """Return whether a controller has published one of these modes just now."""
        said = max(self._said.get((node, mode), LONG_AGO) for mode in modes)
        return self.facts.now - said <= 2 * self.facts.period

    def _moves(self, node: str, state: AgentState) -> None:
        if not self._reset_told and state.broadcast_step != NEVER:
            raise self.broken(node, f"moves in step {state.step}, but nobody has told the swarm to move")

    def _basis(self, node: str, basis: Basis) -> None:
        if basis.source != Source.CONTROLLER or node in self.facts.wrong:
            return
        peers, before = self._laws.get(node), self._answered.get(node, LONG_AGO)
        self._answered[node] = basis.step
        takes_over = peers is not None and basis.step - before > TAKEOVER and basis.step - peers.step <= 2 * TAKEOVER
        calm = node not in self.facts.odd and max(self._said_still(), self._reset_at) < self.facts.now - 3e9
        if peers is not None and takes_over and calm and basis.begun != peers.begun:
            text = f"takes over in step {basis.step} with a law that began in step {basis.begun}"
            raise self.broken(node, f"{text}; that of its peer began in step {peers.begun}")
        restart = self._restarts.get(node)
        if restart is None or basis.begun >= restart - 1:
            return
        if peers is not None and peers.step >= restart and peers.begun == basis.begun:
            return  # its peer has led meanwhile, and not heard of the RESET
        text = f"continues in step {basis.step} the law that began in step {basis.begun}"
        raise self.broken(node, f"{text}, although it was reset in step {restart}")

    def _said_still(self) -> int:
        """Return when STOP or RESET was published last."""
        return max((at for (_, mode), at in self._said.items() if mode != Mode.RUN), default=LONG_AGO)

    def _says(self, node: str, message: Any) -> None:
        facts, mode = self.facts, message.mode
        self._said[node, mode] = facts.now
        if not self._reset_told and mode == Mode.RUN:
            raise self.broken(node, "publishes RUN, but nobody has told the swarm to move")
        if facts.case.paired and facts.case.stopped and mode == Mode.STOP and node not in self._aware:
            raise self.broken(node, "publishes STOP, but has started in it, and neither operator nor peer told it so")
        command, since = self._told.get(node, ("", 0))
        if command != "reset" or node in facts.wrong:
            return
        lasting = (facts.now - since) / 1e9
        others = [at for (other, said), at in self._said.items() if other != node and said == Mode.RUN]
        alone = all(at < since for at in others)
        if (
            mode == Mode.RUN
            and lasting < RESET_LASTS - facts.clock.period
            and alone
            and not facts.odd & {*facts.case.stoppable}
        ):
            raise self.broken(node, f"publishes RUN {lasting:.3f} s after it was told to reset")
        if (
            mode == Mode.RESET
            and lasting > RESET_LASTS + 3 * facts.clock.period
            and not facts.case.paired
            and node not in facts.odd
        ):
            raise self.broken(node, f"still publishes RESET {lasting:.3f} s after it was told to reset")

    def period(self) -> None:
        """Check that what is ordered is repeated."""
        facts = self.facts
        for node, (command, since) in self._told.items():
            if facts.runs_since(node) > since or node in facts.odd:
                continue
            said = self._said.get((node, Mode.STOP if command == "stop" else Mode.RESET), LONG_AGO)
            if command == "stop" and said < since:
                raise self.broken(node, "is told to stop, and does not publish STOP at once")
            over = command == "reset" and facts.now - since > RESET_LASTS * 1e9 - facts.period
            # Where states of the plane become late, its steps wait for them. Of a pair one is enough that says STOP.
            heard = max(self._reset_at, self._heard_stop.get(node, LONG_AGO))
            alone = not facts.case.paired or (command == "stop" and heard < since)
            if alone and not over and facts.now - max(said, since) > (facts.age + 2) * facts.period:
                text = f"was told to {command} {(facts.now - since) / 1e9:.3f} s ago, and no longer says so"
                raise self.broken(node, text)
        if facts.case.paired and all(map(facts.is_fine, facts.case.coordinators)):
            self._pair_repeats()

    def _pair_repeats(self) -> None:
        """Check that one of a pair repeats a STOP."""
        facts = self.facts
        stopped = [at for command, at in self._told.values() if command == "stop"]
        if not stopped or self._reset_at > min(stopped):
            return
        if facts.wrong >= {*facts.case.stoppable}:  # nothing tells which of their orders is newer
            return
        other, newest = sorted(facts.case.stoppable, key=facts.started.__getitem__)
        if facts.runs_since(other) > facts.started[newest] > min(stopped):
            return  # it has started in RUN, while the one that knows the STOP stood still
        said = max(self._said.get((name, Mode.STOP), LONG_AGO) for name in facts.case.stoppable)
        if facts.now - max(said, *stopped) > (facts.age + 2) * facts.period:
            raise self.broken(" and ".join(facts.case.stoppable), "were told to stop, and neither says so")


class ReportsItsHealth(Property):
    """A node that says that it is well is well."""

    name = "reports its health"
    statement = (
        "A robot that does not follow, a controller that does not publish RUN and an observer that misses a robot do "
        "not report that they are well."
    )
    every = 5

    def __init__(self, facts: Facts) -> None:
        super().__init__(facts)
        self._count = 0
        self._well: dict[str, str] = {}
        self._newest: dict[str, dict[int, AgentState]] = {}
        self._spoke: dict[str, tuple[int, int]] = {}
        self._plane: dict[str, int] = {}
        self.published = {AGENT_STATE: self._state}
        if facts.case.each_robot:
            return
        self._newest = {name: {} for name in facts.case.pairs[0]}
        self.published[DESIRED_ABSTRACT_STATE] = self._desired
        self.heard = dict.fromkeys(variants(AGENT_STATE), self._hears)
        self.heard[PLANE_STATE] = self._hears_plane

    def begins(self, node: str) -> None:
        self._well.pop(node, None)
        self._spoke.pop(node, None)
        self._plane.pop(node, None)
        if node in self._newest:
            self._newest[node] = {}

    def told(self, node: str, command: str) -> None:
        self._well.pop(node, None)
        self._spoke.pop(node, None)

    def resumes(self, node: str) -> None:
        self._well.pop(node, None)

    def _hears(self, node: str, parcel: Parcel) -> None:
        newest, state = self._newest.get(node), parcel.message
        if newest is None or not parcel.sender or not isinstance(state, AgentState):
            return
        known = newest.get(state.agent_id)
        if (known is None or state.step > known.step) and state.step <= self.facts.step_of(node) + self.facts.ahead:
            newest[state.agent_id] = state

    def _hears_plane(self, node: str, parcel: Parcel) -> None:
        if parcel.message is not None:
            self._plane[node] = max(self._plane.get(node, LONG_AGO), parcel.message.step)

    def _desired(self, node: str, message: Any) -> None:
        self._spoke[node] = self.facts.now, message.mode

    def _state(self, node: str, state: AgentState) -> None:
        text = self._well.pop(node, None)
        if node in self.facts.wrong:
            return
        if text is not None and state.broadcast_step == NEVER and state.status != Status.LEFT:
            raise self.broken(node, f"reports {text!r} before step {state.step}, in which it does not follow")

    def period(self) -> None:
        """Ask all for their health now and then."""
        self._count += 1
        if self._count % self.every:
            return
        facts = self.facts
        for name, node in facts.fleet.nodes.items():
            begun = facts.runs_since(name) > facts.now - 2 * facts.period  # it has not looked around yet
            if begun or name in facts.wrong or facts.case.each_robot or name == PLANE:
                continue
            assert node.activity is not None
            health = node.activity.engine.behaviour.health(facts.fleet.now(name))
            if health.level != Level.OK:
                continue
            if name in facts.case.robot_names:
                self._well[name] = health.text
            elif name in self._newest:
                self._observes(name, health.text)
            else:
                self._controls(name, health.text)

    def _observes(self, name: str, text: str) -> None:
        facts = self.facts
        if facts.now - facts.runs_since(name) <= 2 * facts.period:
            return
        step = facts.step_of(name)
        for robot, state in self._newest[name].items():
            silent = step - state.step > facts.state_age
            if agent_name(robot) in facts.wrong or robot in facts.removed or state.status == Status.LEFT:
                continue
            if silent or state.status != Status.ACTIVE:
                what = "silent" if silent else Status(state.status).name
                raise self.broken(name, f"reports {text!r}, but in step {step} robot {robot} is {what}")

    def _controls(self, name: str, text: str) -> None:
        facts = self.facts
        at, mode = self._spoke.get(name, (LONG_AGO, Mode.RUN))
        if facts.now - at <= 2 * facts.period and mode == Mode.STOP:
            raise self.broken(name, f"reports {text!r}, and publishes STOP")
        step, heard = facts.step_of(name), self._plane.get(name, LONG_AGO)
        if step - heard > facts.age:
            raise self.broken(
                name, f"reports {text!r} in step {step}, but has no state of the plane since step {heard}"
            )


COORDINATORS: tuple[type[Property], ...] = (
    TakesTurns,
    TellsWhoCounts,
    RestsAndLeaves,
    SpeaksOfOrders,
    ReportsItsHealth,
)
