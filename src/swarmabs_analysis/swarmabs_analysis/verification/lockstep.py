"""Every message of a run, recomputed from those before it (docs/verify.md).

Each node is its own state machine, the one that runs as a process, and hears what the bag holds and nothing else: a
robot the three broadcasts, the observer and the plane the robots' states, the parent controller the plane's state. What
it answers is compared with what the bag holds in its place. As each answer is compared before the next message is
heard, the state that a machine goes on with is the recorded one. The first difference therefore lies with the node that
it names, and with nobody before it.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from swarmabs_analysis.difference import MESSAGE, Difference, judge, missing, surplus
from swarmabs_analysis.verification.base import Ending, Verification
from swarmabs_analysis.verification.window import WINDOW, Window
from swarmabs_bag.recording import Digest, RecordedStep
from swarmabs_config import configure
from swarmabs_core.behaviours import Agent, Controller, Observer, Plane
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.membership import SILENT
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    TOPIC_OF,
    AgentState,
    EventKind,
    SwarmEvent,
)
from swarmabs_core.record import Record

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator

    from swarmabs_analysis.verification.window import Slot
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message, Messages, Topic

COORDINATED = (PLANE_STATE, ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE)


class LockstepVerification(Verification):
    """Verifies a run in lockstep: what a message follows from is known by its step, since all hear all of a step.

    Parameters
    ----------
    scenario : Scenario
        The scenario of the run.
    tolerance : float
        As of `Verification`.

    Attributes
    ----------
    failure : str or None
        Why the run could not go on, if it is part of the bag.
    """

    def __init__(self, scenario: Scenario, *, tolerance: float = 0.0) -> None:
        super().__init__(tolerance)
        self.expected_steps = scenario.steps + 1
        self.failure: str | None = None
        self._scenario = scenario
        self._window = Window(scenario.step_ns, len(scenario.agents))
        self._digest = Digest()
        watching = configure.observer_config(scenario)
        self._observer = Observer(watching)
        self._observer_watches_plane = watching.parent_model is not None
        self._plane = Plane(configure.plane_config(scenario))
        self._controller = Controller(
            configure.controller_config(scenario, recording_window=0), configure.parent_controller(scenario)
        )
        self._agents = {config.agent_id: Agent(config) for config in configure.agent_configs(scenario)}
        self._states: dict[int, AgentState] = {}
        self._told: dict[int, dict[bytes, SwarmEvent]] = {}
        self._late: dict[bytes, SwarmEvent] = {}
        self._beyond: tuple[int, Record | Difference] | None = None
        self._ended = False
        for agent in self._agents.values():
            self._expect(agent.start())

    @property
    def step(self) -> int:
        """The first step that is not verified."""
        return self.steps

    @property
    def decided(self) -> bool:
        """Whether no further message can change what is found."""
        return self.difference is not None and not self._late

    def digest(self) -> str:
        """Return the digest of the verified steps."""
        return self._digest.hexdigest()

    def _step_of_no_message(self, time: int) -> int:
        return time // self._scenario.step_ns

    def _take(self, found: Record | Difference) -> None:
        step = self._window.step_of(found)
        if self.difference is not None:
            if isinstance(found, Record):
                self._late.pop(found.payload, None)
        elif step < self.step:
            self._is_late(found, step)
        elif self._ended:
            self.difference = _unasked(found, step, self.failure or "")
        elif step > self._scenario.steps:
            if self._beyond is None or step < self._beyond[0]:
                self._beyond = (step, found)
        else:
            self._window.add(step, found)
            while self.difference is None and self._ready():
                self._judge(last=False)

    def finish(self, ending: Ending) -> None:
        """Judge what is left at the end of the bag."""
        early = ending is not Ending.WHOLE
        while self.difference is None and len(self._window) and not self._ended:
            self._judge(last=early and self._window.newest == self.step)
        if self.difference is None and self.step <= self._scenario.steps and ending is Ending.WHOLE:
            self.difference = _cut_short(self.step)
        if self.difference is None and self._beyond is not None:
            step, found = self._beyond
            self.difference = _unasked(found, step, "it is not a step of the run")
        expected = [event for event in self._late.values() if ending is Ending.WHOLE or event.step < self.step - WINDOW]
        if expected:
            first = min(expected, key=lambda event: event.step)
            if self.difference is None or self.difference.step is None or first.step < self.difference.step:
                self.difference = missing(EVENTS, first, first.agent_id or None)

    def _ready(self) -> bool:
        """Tell whether all messages of the step are there, or can no longer come."""
        newest, step = self._window.newest, self.step
        if newest <= step:
            return self._window.full
        slot = self._window.get(step)
        present = len(slot.agents) + len(slot.coordinated)
        return self._window.full or newest > step + WINDOW or present >= len(self._states) + len(COORDINATED)

    def _judge(self, *, last: bool) -> None:
        slot = self._window.take(self.step)
        self.difference = next(self._differences(slot, last=last), None)
        if self.difference is None and not self._ended:
            self._add_to_digest(slot)
            self.steps += 1

    def _is_late(self, found: Record | Difference, step: int) -> None:
        """Take a message of a step that was judged: only an event may be that late."""
        if isinstance(found, Record) and found.payload in self._late and self._right(found, self._late[found.payload]):
            del self._late[found.payload]
            self.messages += 1
        else:
            self.difference = _unasked(found, step, "it stands there again, or in the wrong place")

    def _right(self, stored: Record, expected: Message) -> bool:
        return judge(stored, expected, None, self._tolerance, self._time(expected)) is None

    def _time(self, message: Message) -> int:
        """Return the log time of a message, ns: that of its step, whatever its robot's clock says."""
        return message.step * self._scenario.step_ns

    def _differences(self, slot: Slot, *, last: bool) -> Iterator[Difference]:
        """Yield what is wrong in a step; the machines are asked in the order in which they answer in a run."""
        yield from slot.malformed
        dropped = self._dropped(slot)
        for agent_id in dropped:
            self._forget(agent_id, slot)
        if not (yield from self._agent_states(slot, last=last)):
            self._ended = True
            return
        answers = self._ask_observer_and_plane(slot, dropped)
        recorded: dict[Topic, Message] = {}
        for topic in COORDINATED:
            if topic is ABSTRACT_STATE and self._observer_watches_plane:
                self._ask(partial(self._observer.handle, recorded[PLANE_STATE]), answers)
            elif topic is DESIRED_ABSTRACT_STATE:
                self._ask(partial(self._controller.handle, recorded[PLANE_STATE]), answers)
            if not (yield from self._coordinated(slot, topic, answers.get(topic), last=last)):
                self._ended = True
                return
            recorded[topic] = slot.coordinated[topic][0].message
        yield from self._events(slot)
        self._states = {}
        for agent in self._agents.values():
            for topic in agent.needs:
                self._expect(agent.handle(recorded[topic]))

    def _dropped(self, slot: Slot) -> tuple[int, ...]:
        """Return the robots that the observer has declared dead in this step, since they did not answer."""
        if self._scenario.lockstep.on_stall != "drop" or not slot.events:
            return ()
        present = {stored.agent_id for stored in slot.agents}
        dead = {
            event.agent_id
            for event in (stored.message for stored in slot.events)
            if isinstance(event, SwarmEvent) and event.kind == EventKind.DEAD
        }
        return tuple(agent_id for agent_id in self._states if agent_id in dead and agent_id not in present)

    def _forget(self, agent_id: int, slot: Slot) -> None:
        """Expect no more of a robot; whether it could still publish its events of the step, nobody knows."""
        del self._states[agent_id], self._agents[agent_id]
        told, published = self._told.get(self.step, {}), {stored.payload for stored in slot.events}
        for payload in [p for p, event in told.items() if event.agent_id == agent_id and p not in published]:
            del told[payload]

    def _agent_states(self, slot: Slot, *, last: bool) -> Generator[Difference, None, bool]:
        """Yield what is wrong with the robots' states; return whether all are there.

        Of the last step of a bag that breaks off, they may be missing with all that stands behind them.
        """
        found, others = self._sorted(slot)
        last = last and not slot.coordinated and not slot.events
        whole = True
        for agent_id, expected in self._states.items():
            state = found.get(agent_id) or _taken(others, expected)
            if state is not None:
                yield from self._compare(state, expected, agent_id)
            elif last:
                whole = False
            else:
                yield missing(AGENT_STATE, expected, agent_id)
        for stored in others:
            yield surplus(stored, self.step, stored.agent_id, "the robot publishes no such state")
        return whole

    def _sorted(self, slot: Slot) -> tuple[dict[int, Record], list[Record]]:
        """Return the states of a step by robot, of several that name one the most similar, and all others."""
        found = {stored.agent_id: stored for stored in slot.agents}
        if len(found) == len(slot.agents) and found.keys() <= self._states.keys():
            return found, []
        named: dict[int, list[Record]] = {}
        others: list[Record] = []
        for stored in slot.agents:
            agent_id = stored.agent_id
            (named.setdefault(agent_id, []) if agent_id in self._states else others).append(stored)
        found = {}
        for agent_id, several in named.items():
            state = _taken(several, self._states[agent_id])
            assert state is not None  # noqa: S101 - there is one at least
            found[agent_id] = state
            others += several
        return found, others

    def _ask_observer_and_plane(self, slot: Slot, dropped: tuple[int, ...]) -> dict[Topic, Message]:
        """Tell observer and plane who is out and where the robots are; return what they answer by topic."""
        answers: dict[Topic, Message] = {}
        if dropped:
            self._ask(lambda: self._observer.drop(dropped, SILENT), answers)
            for agent_id in dropped:
                out = SwarmEvent(0, self.step, agent_id, EventKind.DEAD, 0.0, SILENT)
                self._ask(partial(self._plane.handle, out), answers)
        for stored in slot.agents:
            self._ask(partial(self._observer.handle, stored.message), answers)
            self._ask(partial(self._plane.handle, stored.message), answers)
        return answers

    def _ask(self, answer: Callable[[], Messages], answers: dict[Topic, Message]) -> None:
        """Let a machine answer; events are expected, other answers noted by topic."""
        if self.failure is not None:
            return
        try:
            heard = answer()
        except RunError as error:
            self.failure = str(error)
            return
        for message in heard:
            if isinstance(message, SwarmEvent):
                self._tell(message)
            else:
                answers[TOPIC_OF[type(message)]] = message

    def _coordinated(
        self, slot: Slot, topic: Topic, expected: Message | None, *, last: bool
    ) -> Generator[Difference, None, bool]:
        """Yield what is wrong on a topic; return whether the run goes on: it may fail, or the bag be cut off, here."""
        found = slot.coordinated.get(topic, [])
        if expected is None:
            for stored in found:
                yield surplus(stored, self.step, None, self.failure or "")
            return False
        if not found:
            later = COORDINATED[COORDINATED.index(topic) :]
            if not last or slot.events or any(slot.coordinated.get(other) for other in later):
                yield missing(topic, expected, None)
            return False
        yield from self._compare(found[0], expected, None)
        for stored in found[1:]:
            yield surplus(stored, self.step, None, "it stands there twice")
        return True

    def _compare(self, stored: Record, expected: Message, agent: int | None) -> Iterator[Difference]:
        difference = judge(stored, expected, agent, self._tolerance, self._time(expected))
        if difference is not None:
            yield difference
        self.messages += 1

    def _events(self, slot: Slot) -> Iterator[Difference]:
        """Yield what is wrong with the events of the step; those that are missing may still come."""
        expected = self._told.pop(self.step, {})
        others = []
        for stored in slot.events:
            event = expected.get(stored.payload)
            if event is not None and self._right(stored, event):
                del expected[stored.payload]
                self.messages += 1
            else:
                others.append(stored)
        for stored in others:
            yield from self._other_event(stored, expected)
        self._late.update(expected)

    def _other_event(self, stored: Record, expected: dict[bytes, SwarmEvent]) -> Iterator[Difference]:
        """Compare an event with the most similar one that is missing."""
        if not expected:
            yield surplus(stored, self.step, stored.agent_id or None, "nothing leads to this event")
            return
        payload = max(expected, key=lambda p: _likeness(stored, expected[p]))
        event = expected.pop(payload)
        yield from self._compare(stored, event, event.agent_id or None)

    def _expect(self, answers: Messages) -> None:
        """Note what a robot will have published in the next step."""
        for answer in answers:
            if isinstance(answer, AgentState):
                self._states[answer.agent_id] = answer
            elif isinstance(answer, SwarmEvent):
                self._tell(answer)

    def _tell(self, event: SwarmEvent) -> None:
        self._told.setdefault(event.step, {})[encode(event)] = event

    def _add_to_digest(self, slot: Slot) -> None:
        stored = (*slot.agents, *(messages[0] for messages in slot.coordinated.values()))
        self._digest.update(RecordedStep(self.step, stored))


def _taken(several: list[Record], expected: Message) -> Record | None:
    """Take the most similar one of several messages, None if there is none."""
    if not several:
        return None
    place = max(range(len(several)), key=lambda n: _likeness(several[n], expected)) if len(several) > 1 else 0
    return several.pop(place)


def _likeness(stored: Record, expected: Message) -> int:
    """Return in how many fields a recorded message is as expected."""
    return sum(a == b for a, b in zip(stored.message, expected, strict=True))


def _cut_short(step: int) -> Difference:
    return Difference(AGENT_STATE.name, step, None, MESSAGE, None, None, "the bag ends here and does not say why")


def _unasked(found: Record | Difference, step: int, reason: str) -> Difference:
    if isinstance(found, Difference):
        return found
    return surplus(found, step, found.agent_id or None, reason)
