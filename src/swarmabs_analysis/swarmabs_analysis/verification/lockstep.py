"""Recomputation of every message of a run in lockstep from the messages before it (docs/how-to/verify.md).

Each node is represented by the state machine that also runs as its process, and receives only recorded messages: a
robot the three broadcasts, the observer and the plane the robots' states, the parent controller the plane's state. Its
answer is compared with the recorded message in its place before the next message is delivered, so that every state
machine continues from recorded inputs. The first difference therefore originates in the node that it names.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, cast

from swarmabs_analysis.difference import MESSAGE, Difference, judge, missing, surplus
from swarmabs_analysis.verification.base import Verification
from swarmabs_analysis.verification.earlier import EarlierEnds
from swarmabs_analysis.verification.recomputation import Recomputation
from swarmabs_analysis.verification.relays import RelayVerification
from swarmabs_bag.run.digest import Digest
from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.scenario import PlaneScenario
from swarmabs_core.behaviours import Observer, Parent
from swarmabs_core.cdr import agent_id_of, encode
from swarmabs_core.errors import RunError
from swarmabs_core.events import EventCode
from swarmabs_core.membership import SILENT, Membership
from swarmabs_core.messages import (
    EVENTS,
    PLANE_STATE,
    ROBOT_STATES,
    TOPIC_OF,
    AgentState,
    EventKind,
    Relay,
    SwarmEvent,
    Topic,
    relay_topic,
)
from swarmabs_core.nodes import CONTROLLER, OBSERVER, PARENT, NodeKind, NodeName
from swarmabs_core.record import Record
from swarmabs_core.relays import Content, StepRelays
from swarmabs_run.simulation import behaviour_of, nodes_in_process
from swarmabs_run.swarm_columns import on_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterable, Iterator

    from swarmabs_analysis.verification.base import Finding
    from swarmabs_analysis.verification.trial import Trial
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import AnyParentState, Message, Messages

WINDOW = 100
"""Number of steps by which the messages of a bag may be out of order."""
OFF_PLANE = "since a robot was off the plane, the former arithmetic did not resolve the plane's motion"
_MOST_PER_MEMBER = 8
"""Upper bound of messages and events per robot or topic in a step."""


class Slot:
    """The recorded messages of one step by topic, and malformed ones; `present` counts those that a step has once.

    `relays` are those of each robot and round; `repeated` has further ones in their places.
    """

    __slots__ = ("by_topic", "malformed", "present", "relays", "repeated")

    def __init__(self, content: Content) -> None:
        self.relays: StepRelays[Record] = StepRelays(content)
        self.repeated: list[Record] = []
        self.by_topic: dict[Topic, list[Record]] = {}
        self.malformed: list[Difference] = []
        self.present = 0

    def __len__(self) -> int:
        relays = len(self.relays) + len(self.repeated)
        return sum(map(len, self.by_topic.values())) + relays + len(self.malformed)

    def get(self, topic: Topic) -> list[Record]:
        """Return the messages on a topic."""
        return self.by_topic.get(topic, [])

    def add(self, stored: Record) -> None:
        """Add a message."""
        if isinstance(stored.message, Relay):
            if self.relays.put(stored.message, stored) is not stored:
                self.repeated.append(stored)
            return
        same = self.by_topic.setdefault(stored.topic, [])
        self.present += isinstance(stored.message, ROBOT_STATES) or not (same or stored.topic is EVENTS)
        same.append(stored)


class Window:
    """The steps that are not judged yet, of a run with the given period (ns) and number of publishers.

    `content` reads what relays tell. `dropped` are the robots that any event so far has told to be dropped.
    """

    def __init__(self, period_ns: int, publishers: int, content: Content) -> None:
        self._period_ns, self._content = period_ns, content
        self.dropped: set[int] = set()
        self._slots: dict[int, Slot] = {}
        self._capacity = (WINDOW + 2) * _MOST_PER_MEMBER * publishers
        self._count = 0
        self.newest = -1

    def __len__(self) -> int:
        return len(self._slots)

    @property
    def full(self) -> bool:
        """Whether it contains more messages than any run has in so many steps."""
        return self._count > self._capacity

    def step_of(self, stored: Record | Difference) -> int:
        """Return the step to which a message belongs: that on which two of log time, stamp and step agree.

        If all three differ, it is the step in the message.
        """
        if isinstance(stored, Difference):
            return stored.step or 0
        message, time = stored.message, stored.time
        stamp, step = message.stamp, message.step
        said = step * self._period_ns
        if said not in {stamp, time} and stamp == time and stamp % self._period_ns == 0:
            return stamp // self._period_ns
        return step

    def add(self, step: int, stored: Record | Difference) -> None:
        """Add a message, or a malformed one, to the slot of a step."""
        self._count += 1
        slot = self._slots.get(step)
        if slot is None:
            slot = self._slots[step] = Slot(self._content)
            self.newest = max(self.newest, step)
        if isinstance(stored, Difference):
            slot.malformed.append(stored)
            return
        slot.add(stored)
        event = stored.message
        if isinstance(event, SwarmEvent) and event.kind == EventKind.DEAD and event.detail == SILENT:
            self.dropped.add(event.agent_id)

    def present(self, step: int) -> int:
        """Return how many of the messages that a step has once are present."""
        return self._slots[step].present if step in self._slots else 0

    def has_relays(self, step: int, robots: Iterable[int]) -> bool:
        """Return whether the relays of all these robots are present, but for those that are dropped."""
        return step in self._slots and self.dropped.issuperset(self._slots[step].relays.lacking(robots))

    def take(self, step: int) -> Slot:
        """Remove the slot of a step and return it."""
        slot = self._slots.pop(step, None) or Slot(self._content)
        self._count -= len(slot)
        return slot


class LockstepVerification(Verification):
    """Verifies a run in lockstep, where the step of a message determines its inputs: all messages of that step.

    The state of the plane may differ by the tolerance `of_plane`, if that is larger than the other. With it, the state
    is checked only until a robot is off the plane.
    The `division` is that of the recorded nodes, by default that of the scenario. On the `absent` topics, which the bag
    of an earlier version lacks, nothing is expected. What robots pass on is verified if the bag is `relayed`.
    `earlier` tells whether its events are those of a version before the ranges of coordinates; see `are_earlier`. With
    a `trial` its nodes are compared with the recording to the end, and all other messages are taken as they are.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        tolerance: float = 0.0,
        of_plane: float = 0.0,
        division: int | None = None,
        absent: Collection[Topic] = (),
        relayed: bool = False,
        earlier: bool = False,
        trial: Trial | None = None,
    ) -> None:
        super().__init__(tolerance, scenario.step_ns)
        self._relays = RelayVerification(scenario, tolerance) if relayed and trial is None else None
        self._of_plane = max(tolerance, of_plane)
        self._end = (scenario.lane_length or inf) / 2.0 if of_plane else inf
        self._off_plane = False
        self._trial = trial
        self.result.expected_steps = scenario.steps + 1
        self._scenario = scenario
        family = scenario.family
        self._robots = family.robot
        self._coordinators = tuple(topic for topic in family.stepwise[1:] if topic not in absent)
        self._topics = tuple(topic for topic in family.recorded if topic not in absent)
        content = Content(configure.members(scenario), family)
        self._window = Window(scenario.step_ns, len(scenario.agents) + len(self._topics), content)
        self._digest = Digest()
        self._membership = Membership(configure.members(scenario), configure.schedule(scenario))
        self._division = configure.division(scenario) if division is None else division
        self._nodes = nodes_in_process(scenario, self._division)
        if earlier:
            config = configure.parent_config(scenario)
            parent = Parent(config, EarlierEnds(config.coordinates))
            self._nodes[PARENT] = self._nodes[PARENT]._replace(behaviour=parent)
        if trial is not None:
            self._nodes |= trial.in_process(self._division)
        self._expected: dict[Topic, dict[int, Message]] = {}
        self._told: dict[int, dict[bytes, SwarmEvent]] = {}
        self._late: dict[bytes, SwarmEvent] = {}
        self._lacking: dict[int, int] = {}  # robots without all of their relays, and since which step
        self._beyond: tuple[int, Record | Difference] | None = None
        self._failure = ""  # why the run could not continue, if the bag shows it
        self._ended = False
        self._recomputation: Recomputation | None = None
        if (
            isinstance(scenario, PlaneScenario)
            and on_columns(scenario)
            and not tolerance
            and trial is None
            and not relayed
        ):
            self._recomputation = Recomputation(scenario, self._nodes)
        self._before: Step | None = None  # the last verified step
        self._confirmed: Step | None = None  # the same if the nodes have to continue after it
        self._steps_apart = 1
        self._handles = self._connect()
        for node in self._nodes.values():
            self._expect(node.behaviour.start())

    @property
    def step(self) -> int:
        """The first step that is not verified yet."""
        return self.result.steps

    @property
    def decided(self) -> bool:
        """Whether no further message can change the result."""
        return self.result.difference is not None and not self._late

    def add_steps(self, steps: Step) -> None:
        """Check the next messages of the bag, which form whole steps: many at once where nothing disturbs the run."""
        while len(steps) and self.result.difference is None:
            self._judge_ready(steps.first)
            count = self._confirm(steps)
            if not count:
                count = self._disturbed(steps.first)
                super().add_steps(steps[:count])
            steps = steps[count:]

    def _confirm(self, steps: Step) -> int:
        """Return how many steps are verified at once."""
        disturbed = self._told or self._failure or self._ended or len(self._window) or steps.first != self.step
        if self._recomputation is None or disturbed or self._before is None:
            return 0
        count = self._recomputation.confirmed(self._before, steps[: self._scenario.steps + 1 - steps.first])
        if count:
            self._steps_apart = 1
            self._digest.update(steps[:count])
            self.result.messages += steps[:count].messages
            self.result.steps += count
            self._before = self._confirmed = steps[count - 1 : count]
        return count

    def _disturbed(self, step: int) -> int:
        """Return how many steps from one on to verify message by message: more each time, unless it is known."""
        until_quiet = 0 if self._recomputation is None else self._recomputation.quiet(step)[0] - step
        if not until_quiet:
            self._steps_apart *= 2
        return until_quiet or self._steps_apart

    def _continue(self) -> None:
        """Let the nodes continue after a step that was verified without them."""
        last, self._confirmed = self._confirmed, None
        if last is None or self._recomputation is None:
            return
        self._recomputation.resume(last)
        self._expected = {}
        for record in last.records:
            if record.topic in self._scenario.family.broadcasts:
                for handle in self._handles[record.topic]:
                    self._ask(handle, record.message)

    def _take(self, stored: Record | Difference) -> None:
        self._continue()
        step = self._window.step_of(stored)
        if self.result.difference is not None:
            if isinstance(stored, Record):
                self._late.pop(stored.payload, None)
        elif step < self.step:
            self._take_late(stored, step)
        elif self._ended:
            self.result.difference = _unasked(stored, step, self._failure)
        elif step > self._scenario.steps:
            if self._beyond is None or step < self._beyond[0]:
                self._beyond = (step, stored)
        else:
            self._window.add(step, stored)
            self._judge_ready(self._window.newest)

    def _judge_ready(self, newest: int) -> None:
        """Judge the steps that are complete when messages of a newest step have been read."""
        while self.result.difference is None and newest <= self._scenario.steps and self._ready(newest):
            self._judge_step(last=False)

    def finish(self, *, whole: bool = True) -> None:
        """Judge the remaining messages at the end of the bag."""
        result = self.result
        while result.difference is None and len(self._window) and not self._ended:
            self._judge_step(last=not whole and self._window.newest == self.step)
        if result.difference is None and self.step <= self._scenario.steps and whole:
            reason = "the bag ends here without giving a reason"
            result.difference = Difference(self._robots.name, self.step, None, MESSAGE, None, None, reason)
        if result.difference is None and self._beyond is not None:
            step, beyond = self._beyond
            result.difference = _unasked(beyond, step, "it is not a step of the run")
        late = [event for event in self._late.values() if whole or event.step < self.step - WINDOW]
        if late:
            self._differs_before(missing(min(late, key=lambda event: event.step)))
        if whole and (lacking := sorted((at, i) for i, at in self._lacking.items() if i not in self._window.dropped)):
            step, robot = lacking[0]
            topic, reason = relay_topic(robot).name, "not all of its relays are there, and it is not dropped"
            self._differs_before(Difference(topic, step, robot, MESSAGE, None, None, reason))
        result.digest = self._digest.hexdigest()
        if self._trial is not None:
            self._trial.report(result)

    def _differs_before(self, first: Difference) -> None:
        """Report a difference that is known only at the end, unless there is an earlier one."""
        known = self.result.difference
        if known is None or known.step is None or (first.step is not None and first.step < known.step):
            self.result.difference = first

    def _ready(self, newest: int) -> bool:
        """Return whether all messages of the step are present, or can no longer follow those of a newest step."""
        step = self.step
        if newest <= step:
            return self._window.full
        several = (self._robots, *self._scenario.family.once)
        whole = sum(len(self._expected.get(topic, ())) for topic in several) + len(self._coordinators)
        whole += self._membership.divides(step, self._division)
        if self._window.full or newest > step + WINDOW:
            return True
        relayed = self._relays is None or self._window.has_relays(step, self._membership.lasting(step))
        return relayed and self._window.present(step) >= whole

    def _judge_step(self, *, last: bool) -> None:
        slot = self._window.take(self.step)
        self._judge(self._findings(slot, last=last))
        if self.result.difference is None and not self._ended:
            stored = (*slot.get(self._robots), *(slot.by_topic[topic][0] for topic in self._coordinators))
            self._before = Step.of(self.step, stored)
            self._digest.update(self._before)
            self.result.steps += 1

    def _take_late(self, stored: Record | Difference, step: int) -> None:
        """Handle a message of a step that was already judged: only an event may be that late."""
        if self._trial is not None and isinstance(stored, Record) and stored.topic is EVENTS:
            return
        expected = self._late.get(stored.payload) if isinstance(stored, Record) else None
        if isinstance(stored, Record) and expected is not None and self._is(stored, expected):
            del self._late[stored.payload]
            self.result.messages += 1
        else:
            self.result.difference = _unasked(stored, step, "it is a duplicate, or out of place")

    def _differs(self, stored: Record, expected: Message) -> Finding:
        """Compare a message; its log time must be that of its step, regardless of the robot's clock."""
        if self._trial is not None:
            self._trial.compare(stored, expected)
            return None
        if self._off_plane and stored.topic is PLANE_STATE:
            return OFF_PLANE
        tolerance = self._of_plane if stored.topic is PLANE_STATE else self.result.tolerance
        return judge(stored, expected, tolerance, expected.step * self._scenario.step_ns)

    def _is(self, stored: Record, expected: Message) -> bool:
        return self._differs(stored, expected) is None

    def _findings(self, slot: Slot, *, last: bool) -> Iterator[Finding]:
        """Yield the findings of a step; the state machines are called in the order in which they answer in a run."""
        yield from slot.malformed
        self._off_plane = self._off_plane or any(
            isinstance(stored.message, AgentState) and abs(stored.message.position) > self._end
            for stored in slot.get(self._robots)
        )
        dropped = self._drop_silent(slot)
        for number, topic in enumerate(self._topics):
            later = (*self._topics[number + 1 :], EVENTS)
            cut = last and not any(other in slot.by_topic for other in later)
            if not (yield from self._on_topic(slot, topic, cut=cut)):
                self._ended = True
                return
            if topic is self._scenario.family.parent and self._relays is not None:
                states, parent = slot.get(self._robots), cast("AnyParentState", slot.get(topic)[0].message)
                relays = slot.relays.ordered()
                if self._is_timed(slot, dropped):
                    yield from self._relays.timed(self.step, parent, states, relays, dropped)
                else:
                    yield from self._relays.findings(self.step, parent, states, relays, cut=last)
                yield from (surplus(stored, self.step, "it is a duplicate") for stored in slot.repeated)
            for stored in slot.get(topic):
                for handle in self._handles[topic]:
                    self._ask(handle, stored.message)
        yield from self._events(slot)

    def _connect(self) -> dict[Topic, list[Callable[[Message], Messages]]]:
        """Return the handlers of the state machines by topic, in the order in which they answer."""
        nodes: dict[NodeName, Callable[[Message], Messages]] = {
            name: node.behaviour.handle for name, node in self._nodes.items()
        }
        if self._trial is not None:
            nodes = {name: self._trial.hearing(name, handle) for name, handle in nodes.items()}
        if self._recomputation is not None:
            nodes[CONTROLLER] = self._recomputation.control
        return {
            topic: [nodes[name] for name, node in self._nodes.items() if topic in node.hears] for topic in self._topics
        }

    def _ask(self, answer: Callable[..., Messages], *given: object) -> None:
        """Call a state machine, unless the run has failed."""
        if self._failure:
            return
        try:
            self._expect(answer(*given))
        except RunError as error:
            self._failure = str(error)

    def _expect(self, answers: Messages) -> None:
        """Note the messages that the bag must contain."""
        for answer in answers:
            if isinstance(answer, SwarmEvent):
                self._told.setdefault(answer.step, {})[encode(answer)] = answer
            else:
                self._expected.setdefault(TOPIC_OF[type(answer)], {})[agent_id_of(answer)] = answer

    def _is_timed(self, slot: Slot, dropped: Collection[int]) -> bool:
        """Return whether it depended on time which relays robots sent in a step, because one of them was silent.

        That is so if they tell votes, or if a robot that is dropped in this step or later has ended before its last
        relay. Whether it is dropped may be known only at the end of the bag, or never if that is cut off.
        """
        if self._scenario.lockstep.on_stall != "drop":
            return False
        if slot.relays.voted or dropped:
            return True
        lacking = slot.relays.lacking(self._membership.lasting(self.step))
        for robot in lacking:
            self._lacking.setdefault(robot, self.step)
        return bool(lacking)

    def _drop_silent(self, slot: Slot) -> list[int]:
        """Drop the robots that are declared dead in this step because they did not answer, and return them.

        Such a robot is expected to publish nothing more; it may or may not have published its events of the step.
        Without an observer even one that has yet to join must answer, since it passes on what it hears.
        """
        events = slot.get(EVENTS)
        if self._scenario.lockstep.on_stall != "drop" or not events:
            return []
        present = {stored.agent_id for stored in slot.get(self._robots)}
        dead = {
            m.agent_id for m in (e.message for e in events) if isinstance(m, SwarmEvent) and m.kind == EventKind.DEAD
        }
        states = self._expected.get(self._robots, {})
        answering = self._membership.lasting(self.step) if self._scenario.decentralised else states
        dropped = [agent_id for agent_id in answering if agent_id in dead - present]
        published = {stored.payload for stored in events}
        told = self._told.get(self.step, {})
        for agent_id in dropped:
            states.pop(agent_id, None)
            del self._nodes[NodeName(NodeKind.AGENT, agent_id)]
            for payload in [p for p, event in told.items() if event.agent_id == agent_id and p not in published]:
                del told[payload]
        if dropped:
            self._handles = self._connect()
            self._ask(behaviour_of(self._nodes, OBSERVER, Observer).drop, dropped, SILENT)
            for agent_id in dropped:
                self._ask(self._nodes[PARENT].behaviour.handle, EventCode.SILENT.event(0, self.step, robot=agent_id))
                self._membership.end(agent_id, self.step - 1, stays=True, reason=SILENT)
        return dropped

    def _on_topic(self, slot: Slot, topic: Topic, *, cut: bool) -> Generator[Finding, None, bool]:
        """Yield the findings on a topic; return whether the run continues.

        If it has failed, or the bag is cut off, messages may be missing from here on.
        """
        expected = self._expected.pop(topic, {})
        assigned, others = _assigned(slot.get(topic), expected)
        whole = bool(expected) or topic not in self._coordinators
        for agent_id, message in expected.items():
            stored = assigned.get(agent_id) or (_taken(others, message) if others else None)
            if stored is not None:
                yield self._differs(stored, message)
            elif cut:
                whole = False
            else:
                yield missing(message)
        robots = "no robot publishes this state"
        reason = robots if topic is self._robots else "it is a duplicate" if expected else self._failure
        for stored in others:
            yield surplus(stored, self.step, reason)
        return whole

    def _events(self, slot: Slot) -> Iterator[Finding]:
        """Yield the findings on the events of the step; missing ones may still follow. A trial compares none."""
        expected = self._told.pop(self.step, {})
        if self._trial is not None:
            return
        others = []
        for stored in slot.get(EVENTS):
            event = expected.get(stored.payload)
            if event is not None and self._is(stored, event):
                del expected[stored.payload]
                yield None
            else:
                others.append(stored)
        for stored in others:
            if not expected:
                yield surplus(stored, self.step, "nothing causes this event")
            else:  # compare it with the most similar missing event
                payload = max(expected, key=lambda p: _likeness(stored, expected[p]))
                yield self._differs(stored, expected.pop(payload))
        self._late.update(expected)


def _assigned(several: list[Record], expected: dict[int, Message]) -> tuple[dict[int, Record], list[Record]]:
    """Return the messages of a topic by robot, and the remaining ones.

    Of several messages of a robot this is the most similar one; of several of a coordinator, the first.
    """
    assigned = {stored.agent_id: stored for stored in several}
    if len(assigned) == len(several) and assigned.keys() <= expected.keys():
        return assigned, []
    assigned = {}
    others: list[Record] = []
    by_robot: dict[int, list[Record]] = {}
    for stored in several:
        (by_robot.setdefault(stored.agent_id, []) if stored.agent_id in expected else others).append(stored)
    for agent_id, same in by_robot.items():
        assigned[agent_id] = _taken(same, expected[agent_id]) if agent_id else same.pop(0)
        others += same
    return assigned, others


def _taken(several: list[Record], expected: Message) -> Record:
    """Remove the most similar of several messages and return it."""
    return several.pop(max(range(len(several)), key=lambda n: _likeness(several[n], expected)))


def _likeness(stored: Record, expected: Message) -> int:
    """Return the number of fields in which a recorded message is as expected."""
    return sum(a == b for a, b in zip(stored.message, expected, strict=True))


def _unasked(stored: Record | Difference, step: int, reason: str) -> Difference:
    return stored if isinstance(stored, Difference) else surplus(stored, step, reason)
