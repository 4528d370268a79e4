"""Recomputation of many steps of a swarm on the plane at once.

Apart from the parent controller, nobody remembers more than the step before: a robot's state follows from its previous
one and the broadcasts of that step, the plane's from its previous one and the robots' at both ends of the period, the
observer's answers from the robots' states. With recorded inputs, all steps are therefore computed side by
side, by the formulas of the state machines on arrays, and compared byte by byte.

This only confirms messages. Where one differs, where a fault, a change of the membership or of the disturbance is near,
or where a robot brakes or leaves the plane's ends, the state machines continue and tell what they find.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from swarmabs_bag.run.step import Step
from swarmabs_config import configure
from swarmabs_config.publishers import PUBLISHER
from swarmabs_core.abstraction import is_degenerate
from swarmabs_core.arrays import LAYOUT, raw
from swarmabs_core.behaviours import Agent, Observer, Parent
from swarmabs_core.cdr import ENCAPSULATION, FRAME, SECOND, encode
from swarmabs_core.elementary import cos, sin, tanh
from swarmabs_core.elementary_arrays import elementwise
from swarmabs_core.errors import RunError
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    TOPIC_OF,
)
from swarmabs_core.nodes import CONTROLLER, OBSERVER, PARENT, NodeKind, NodeName
from swarmabs_core.plant import PlaneDynamics
from swarmabs_core.ranges import RangeMonitor, lane
from swarmabs_core.steering import StepSchedule
from swarmabs_run.simulation import behaviour_of
from swarmabs_run.swarm_columns import Standing, SwarmColumns

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from swarmabs_config.scenario import PlaneScenario
    from swarmabs_core.messages import AnyRobotState, Message, Messages, Topic
    from swarmabs_run.simulation import NodeInProcess

    Floats = NDArray[np.float64]

_FOREVER = 2**63


class Recomputation:
    """Recomputes many steps of a run, next to the state machines of its nodes, which it advances.

    Parameters
    ----------
    scenario : PlaneScenario
        One that is `on_columns`.
    nodes : mapping
        The nodes, which have answered the step before.
    """

    def __init__(self, scenario: PlaneScenario, nodes: Mapping[NodeName, NodeInProcess]) -> None:
        self._scenario = scenario
        self._nodes = nodes
        self._period_ns = scenario.step_ns
        self._dynamics = PlaneDynamics(scenario.plane, scenario.period)
        self._disturbances = StepSchedule(configure.parent_config(scenario).torques)
        self._configs = {config.agent_id: config for config in configure.agent_configs(scenario)}
        self._disturbed = sorted(_disturbed(scenario, self._disturbances))
        self._borders = RangeMonitor(lane(scenario.plane.length)).borders()
        self._columns: SwarmColumns | None = None
        self._ahead: tuple[int, Messages | RunError] | None = None

    def quiet(self, step: int) -> tuple[int, int]:
        """Return the first steps, from one step on, that can be recomputed, and before which they no longer can."""
        first, end = step, _FOREVER
        for begin, last in self._disturbed:  # sorted; the step before is an input
            if begin <= first and first - 1 <= last:
                first = last + 2
            elif begin > first:
                end = min(end, begin)
        return first, end

    def confirmed(self, before: Step, steps: Step) -> int:
        """Return how many steps are as recomputed from the confirmed step before it; advance the controller.

        The other nodes continue with `resume`.
        """
        first, end = self.quiet(steps.first)
        if first > steps.first or not before.alike(steps) or self._ahead is not None:
            return 0
        steps = steps[: end - steps.first]
        numbers = np.arange(steps.first, steps.step + 1, dtype=np.uint64)
        stamps = numbers.astype(np.int64) * self._period_ns
        with np.errstate(all="ignore"):
            right, expected = self._expected(before, steps, numbers, stamps)
        for topic, table in expected.items():
            same = (raw(table) == raw(steps.tables[topic])).reshape(len(steps), -1)
            right &= same.all(axis=1)
        count = len(steps) if right.all() else int(np.argmin(right))
        return self._controlled(steps[:count]) if count else 0

    def _expected(
        self, before: Step, steps: Step, numbers: NDArray[np.uint64], stamps: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], dict[Topic, NDArray[np.void]]]:
        """Return in which steps the state machines would compute the same, and what; `confirmed` compares.

        Parameters
        ----------
        before, steps : Step
            The step before, and the steps to confirm.
        numbers, stamps : ndarray, (K,)
            Numbers and time stamps (ns) of the steps.
        """
        columns = self._of(steps)
        tables = {topic: np.concatenate((before.tables[topic], table)) for topic, table in steps.tables.items()}
        robots = tables[AGENT_STATE]
        p, v = (np.ascontiguousarray(robots[name].T)[columns.places] for name in ("position", "velocity"))
        start, end = (p[:, :-1], v[:, :-1]), (p[:, 1:], v[:, 1:])
        heard = [_named(tables[topic][:-1]) for topic in (ABSTRACT_STATE, AUXILIARY_STATE, DESIRED_ABSTRACT_STATE)]
        command = columns.commands(*start, *heard)
        motion = (*columns.moved(*start, command), command)
        observer = behaviour_of(self._nodes, OBSERVER, Observer)
        plane = behaviour_of(self._nodes, PARENT, Parent)
        load = columns.load(start, end, _standing(plane.standing(columns.ids), len(numbers)))
        earlier = _named(tables[PLANE_STATE][:-1])
        times = np.array([int(stamp) / 1e9 for stamp in stamps - self._period_ns])
        moved = self._dynamics.advance_each(
            earlier.angle, earlier.angular_velocity, times, load, self._disturbances.at(int(numbers[0]) - 1), _EACH
        )
        abstract, auxiliary = columns.observed(numbers, stamps, *end, _standing(observer.standing, len(numbers)))
        length = self._scenario.plane.length
        zones = zones_of(p, self._borders)
        same = (zones[:, 1:] == zones[:, :1]) & (zones[:, :1] >= 0)
        spreads = zip(heard[1].s0.tolist(), heard[1].s3.tolist(), strict=True)
        held = np.array([is_degenerate(s0, s3, length) for s0, s3 in spreads])
        finite = np.isfinite(command).all(axis=0) & np.isfinite(moved).all(axis=0)
        answers = {PLANE_STATE: moved, ABSTRACT_STATE: abstract[2:], AUXILIARY_STATE: auxiliary[2:]}
        return finite & ~held & same.all(axis=0), {
            AGENT_STATE: columns.states(numbers, stamps, *(values.T for values in motion)),
            **{topic: _rows(topic, numbers, stamps, values) for topic, values in answers.items()},
        }

    def _of(self, steps: Step) -> SwarmColumns:
        """Return the robots of steps as columns."""
        ids = steps.tables[AGENT_STATE]["agent_id"][0].tolist()
        if self._columns is None or sorted(self._columns.ids) != ids:
            configs = [self._configs[agent_id] for agent_id in ids]
            self._columns = SwarmColumns(self._scenario, configs, steps=True)
        return self._columns

    def _controlled(self, steps: Step) -> int:
        """Return how many steps the parent controller answers as recorded, without events.

        Its answer in the first other step is kept for `control`.
        """
        controller = self._nodes[CONTROLLER].behaviour
        answers = {topic: table for topic, table in steps.tables.items() if PUBLISHER.get(topic) == CONTROLLER}
        for place, parent in enumerate(steps.parents):
            try:
                answer: Messages | RunError = controller.handle(parent)
            except RunError as error:
                answer = error
            if isinstance(answer, RunError) or not _is_recorded(answer, answers, place):
                self._ahead = (parent.step, answer)
                return place
        return len(steps)

    def control(self, message: Message) -> Messages:
        """Return the parent controller's answer to a message, which it may have given already."""
        ahead, self._ahead = self._ahead, None
        if ahead is None or ahead[0] != message.step:
            return self._nodes[CONTROLLER].behaviour.handle(message)
        if isinstance(ahead[1], RunError):
            raise ahead[1]
        return ahead[1]

    def resume(self, last: Step) -> None:
        """Let the other nodes continue after a step: the robots once they hear its broadcasts."""
        states = list(last.states())
        behaviour_of(self._nodes, OBSERVER, Observer).resume(states)
        behaviour_of(self._nodes, PARENT, Parent).resume(states, last.parents[0])
        for state in states:
            behaviour_of(self._nodes, NodeName(NodeKind.AGENT, state.agent_id), Agent).resume(state)


def _is_recorded(answer: Messages, tables: Mapping[Topic, NDArray[np.void]], place: int) -> bool:
    """Return whether an answer without events has the messages at a place of these tables."""
    given = {TOPIC_OF[type(message)]: encode(message) for message in answer}
    return EVENTS not in given and all(given.get(topic) == table[place].tobytes() for topic, table in tables.items())


def zones_of(values: Floats, borders: Sequence[float]) -> NDArray[np.int64]:
    """Return between which borders each value is, -1 on one."""
    before, after = (np.searchsorted(borders, values, side=side) for side in ("left", "right"))
    return np.where((before == after) & ~np.isnan(values), before, -1)


def _disturbed(scenario: PlaneScenario, disturbances: StepSchedule) -> Iterator[tuple[int, int]]:
    """Yield first and last steps of the ranges that are left to the state machines, with the steps next to them."""
    for change in configure.schedule(scenario):
        yield change.step - 1, change.step + 2
    for step in disturbances.steps:
        yield step - 1, step + 1
    for config in configure.agent_configs(scenario):
        for fault in config.faults:
            yield fault.first - 1, _FOREVER if fault.end is None else fault.end + 1


def _circle(angles: Floats) -> tuple[Floats, Floats]:
    return elementwise(sin, angles), elementwise(cos, angles)


_EACH = (_circle, partial(elementwise, cos), partial(elementwise, tanh))


def _named(table: NDArray[np.void]) -> SimpleNamespace:
    """Return the fields of messages as attributes."""
    return SimpleNamespace(**{name: np.ascontiguousarray(table[name]) for name in table.dtype.names or ()})


def _standing(states: Sequence[AnyRobotState], steps: int) -> Standing | None:
    """Return robots that stand, with masses (M, 1) and positions (M, K); None without such."""
    if not states:
        return None
    mass, position = (np.array([[getattr(state, name)] for state in states]) for name in ("mass", "position"))
    return Standing([state.agent_id for state in states], mass, np.repeat(position, steps, axis=1))


def _rows(
    topic: Topic, steps: NDArray[np.uint64], stamps: NDArray[np.int64], values: Iterable[object]
) -> NDArray[np.void]:
    """Return messages of a topic with the values of their fields behind the step."""
    rows = np.zeros(len(steps), dtype=LAYOUT[topic])
    rows["encapsulation"], rows["frame"] = np.void(ENCAPSULATION), np.void(FRAME)
    rows["sec"], rows["nanosec"] = np.divmod(stamps, SECOND)
    rows["step"] = steps
    for name, value in zip(topic.message._fields[2:], values, strict=True):
        rows[name] = value
    return rows
