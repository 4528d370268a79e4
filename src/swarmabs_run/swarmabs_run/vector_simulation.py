"""Simulation of large swarms with all robots on arrays, bit for bit identical to the state machines."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeVar, cast

import numpy as np

from swarmabs_bag.run.step import STEP_BYTES, STEP_SECONDS, Step, rows_of
from swarmabs_config import configure
from swarmabs_config.scenario import PlaneScenario
from swarmabs_core.abstraction import is_degenerate
from swarmabs_core.arrays import LAYOUT, table
from swarmabs_core.behaviours import Controller
from swarmabs_core.cdr import encode
from swarmabs_core.membership import ALWAYS
from swarmabs_core.messages import (
    AGENT_STATE,
    PLANE_FAMILY,
    TOPIC_OF,
    PlaneState,
    SwarmEvent,
)
from swarmabs_core.plant import PlaneDynamics
from swarmabs_core.ranges import RangeMonitor, lane
from swarmabs_run.swarm_columns import NotVectorisableError, SwarmColumns, on_columns
from swarmabs_run.system_columns import SystemSwarm, system_on_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import (
        AbstractState,
        AnyBroadcast,
        AnyParentState,
        AuxiliaryState,
        Broadcast,
        Family,
        Messages,
    )
    from swarmabs_core.model import Observed
    from swarmabs_core.systems.interface import Quantity

    Floats = NDArray[np.float64]


MotionT = TypeVar("MotionT")


def vectorised(scenario: Scenario) -> Swarm[Any] | None:
    """Return all robots of a scenario with their parent, at step 0.

    None if they do not always behave alike, or use laws that do not support arrays. If robots may be dropped, each step
    has a message of the observer more, which arrays do not provide; nor do they provide further topics that are not the
    controller's.
    """
    if scenario.faults or scenario.decentralised or configure.division(scenario) >= ALWAYS:
        return None
    if isinstance(scenario, PlaneScenario):
        return PlaneSwarm(scenario) if on_columns(scenario) else None
    return SystemSwarm(scenario) if system_on_columns(scenario) else None


class Swarm(Protocol[MotionT]):
    """All robots of a swarm with their parent, at one step."""

    @property
    def family(self) -> Family:
        """The topics."""
        ...

    @property
    def ids(self) -> Sequence[int]:
        """Ids of the robots, in the order of `places`."""
        ...

    @property
    def ranges(self) -> Sequence[Quantity]:
        """The coordinates of a robot, with their ends."""
        ...

    @property
    def size(self) -> int:
        """Size of the robots' messages of a step, bytes."""
        ...

    def observed(self, step: int, stamp: int) -> Observed:
        """Return abstract and auxiliary state."""
        ...

    def parent(self, step: int, stamp: int) -> AnyParentState:
        """Return the state of the parent."""
        ...

    def move(self, heard: AnyBroadcast) -> None:
        """Command all robots by the broadcasts of a step, and move them and the parent for one period.

        Raises `NotVectorisableError` if a robot has to behave individually.
        """
        ...

    def places(self) -> Floats:
        """Return the coordinates of the robots, (N, d)."""
        ...

    def motion(self) -> MotionT:
        """Return what changes of the robots, arrays that are not written to any more."""
        ...

    def states(
        self, steps: NDArray[np.uint64], stamps: NDArray[np.int64], motions: Sequence[MotionT]
    ) -> NDArray[np.void]:
        """Return the robots' messages of K steps with their stamps (ns), by step and ascending id: (K, N)."""
        ...


class Motion(NamedTuple):
    """Positions (m), velocities (m/s) and commands of the robots, (N,)."""

    position: Floats
    velocity: Floats
    command: Floats


class PlaneSwarm:
    """Robots on the plane, as `Swarm`."""

    family = PLANE_FAMILY

    def __init__(self, scenario: PlaneScenario) -> None:
        configs = {config.agent_id: config for config in configure.agent_configs(scenario)}
        plane = scenario.plane
        self._columns = SwarmColumns(scenario, configs.values())
        self.ids = self._columns.ids
        self.ranges = lane(plane.length)
        self.size = LAYOUT[AGENT_STATE].itemsize * len(configs)
        self._motion = Motion(
            np.array([configs[agent_id].position for agent_id in self.ids]),
            np.array([configs[agent_id].velocity for agent_id in self.ids]),
            np.zeros(len(configs)),
        )
        self._dynamics = PlaneDynamics(plane, scenario.period)
        self._plane = plane.angle, plane.angular_velocity
        self._length = plane.length

    def observed(self, step: int, stamp: int) -> tuple[AbstractState, AuxiliaryState]:
        """Return abstract and auxiliary state, as `swarmabs_core.abstraction` defines them."""
        return self._columns.observed(step, stamp, *self._motion[:2])

    def parent(self, step: int, stamp: int) -> PlaneState:
        """Return the state of the plane."""
        return PlaneState(stamp, step, *self._plane)

    def move(self, heard: AnyBroadcast) -> None:
        """Command all robots by the broadcasts of a step, and move them and the plane for one period."""
        stamp, _, abstract, auxiliary, desired = cast("Broadcast", heard)
        if is_degenerate(auxiliary.s0, auxiliary.s3, self._length):
            raise NotVectorisableError
        columns, before = self._columns, self._motion[:2]
        command = columns.commands(*before, abstract, auxiliary, desired)
        if not bool(np.isfinite(command).all()):
            raise NotVectorisableError
        after = columns.moved(*before, command)
        self._motion = Motion(*after, command)
        self._plane = self._dynamics.advance(*self._plane, stamp / 1e9, columns.load(before, after))

    def places(self) -> Floats:
        """Return the positions of the robots, (N, 1)."""
        return self._motion.position[:, np.newaxis]

    def motion(self) -> Motion:
        """Return positions, velocities and commands."""
        return self._motion

    def states(
        self, steps: NDArray[np.uint64], stamps: NDArray[np.int64], motions: Sequence[Motion]
    ) -> NDArray[np.void]:
        """Return the robots' messages of K steps with their stamps (ns), by step and ascending id: (K, N)."""
        return self._columns.states(steps, stamps, *map(np.array, zip(*motions, strict=True)))


class _Gathered(Generic[MotionT]):
    """The steps that are not yielded yet."""

    def __init__(self, swarm: Swarm[MotionT]) -> None:
        self._swarm = swarm
        self._motions: list[MotionT] = []
        self._messages: list[tuple[int, int]] = []
        self._payloads: list[tuple[bytes, ...]] = []
        self._most = 0
        self._begun = 0.0

    @property
    def full(self) -> bool:
        """Whether the steps are as many, or as old, as a `Step` may be."""
        return len(self._motions) >= self._most or time.monotonic() - self._begun >= STEP_SECONDS

    def add(self, messages: Messages) -> None:
        """Add the messages of the coordinators in a step, in the order of a bag, and the state of the robots."""
        payloads = tuple(map(encode, messages))
        if not self._motions:
            self._begun = time.monotonic()
            self._most = max(1, STEP_BYTES // (self._swarm.size + sum(map(len, payloads))))
        self._motions.append(self._swarm.motion())
        self._messages.append(messages[0][:2])
        self._payloads.append(payloads)

    def take(self, once: Messages = (), events: Messages = ()) -> Iterator[Step]:
        """Yield the steps together, with further messages of the last one, and begin anew."""
        if not self._motions:
            return
        family = self._swarm.family
        columns = zip(family.stepwise[1:], zip(*self._payloads, strict=True), strict=True)
        tables = {topic: table(topic, b"".join(payloads)) for topic, payloads in columns}
        stamps, steps = zip(*self._messages, strict=True)
        tables[family.robot] = self._swarm.states(np.array(steps, dtype=np.uint64), np.array(stamps), self._motions)
        for gathered in (self._motions, self._messages, self._payloads):
            gathered.clear()
        # What is said once is said in step 0, which then comes on its own.
        tables |= {topic: rows_of(topic, [encode(said)]) for topic, said in zip(family.once, once, strict=False)}
        yield Step(steps[0], tables, tuple(sorted(map(encode, events))))


class VectorSimulation:
    """Simulates a scenario with its `vectorised` robots, which are at step 0."""

    def __init__(self, scenario: Scenario, swarm: Swarm[Any]) -> None:
        self._scenario = scenario
        self._controller = Controller(configure.controller_config(scenario, recording_window=0))
        self._swarm = swarm
        self._ranges = RangeMonitor(self._swarm.ranges)

    def steps(self) -> Iterator[Step]:
        """Run, and yield the steps together, up to one with events.

        Raises `NotVectorisableError` if a robot has to behave individually; the steps before it are valid. Raises
        `RunError` if the run fails, such as when the plane turns over.
        """
        gathered = _Gathered(self._swarm)
        once: Messages = configure.parent_config(self._scenario).motion().described()
        try:
            for messages, events in self._messages():
                gathered.add(messages)
                if once or events or gathered.full:
                    yield from gathered.take(once, events)
                    once = ()
        except Exception:
            yield from gathered.take()
            raise
        yield from gathered.take()

    def _messages(self) -> Iterator[tuple[Messages, Messages]]:
        """Yield the messages of the coordinators, in the order of a bag, and the events of every step.

        The robots are at that step then.
        """
        scenario, swarm = self._scenario, self._swarm
        family = swarm.family
        packed = cast("Callable[..., AnyBroadcast]", family.packed.message)
        for step in range(scenario.steps + 1):
            stamp = step * scenario.step_ns
            observed = swarm.observed(step, stamp)
            parent = swarm.parent(step, stamp)
            answers = self._controller.handle(parent)
            said = {TOPIC_OF[type(message)]: message for message in (parent, *observed, *answers)}
            events = (message for message in answers if isinstance(message, SwarmEvent))
            yield tuple(said[topic] for topic in family.stepwise[1:]), (*self._crossings(step, stamp), *events)
            if step == scenario.steps:
                return
            swarm.move(packed(stamp, step, *(said[topic] for topic in family.broadcasts)))

    def _crossings(self, step: int, stamp: int) -> list[SwarmEvent]:
        """Return an event for each robot that has just crossed an end of its range."""
        places = self._swarm.places()
        if self._ranges.quiet(float(np.abs(places).max()), same=True):
            return []
        return self._ranges.watch(zip(self._swarm.ids, places.tolist(), strict=True), step, stamp)
