"""Simulation of large swarms with all robots on arrays, bit for bit identical to the state machines."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from swarmabs_bag.blocks import BLOCK_BYTES, BLOCK_SECONDS, Block
from swarmabs_config import configure
from swarmabs_core.abstraction import is_degenerate
from swarmabs_core.arrays import LAYOUT, table
from swarmabs_core.behaviours import Controller
from swarmabs_core.cdr import encode
from swarmabs_core.membership import ALWAYS
from swarmabs_core.messages import (
    AGENT_STATE,
    MAIN_TOPICS,
    AbstractState,
    AuxiliaryState,
    DesiredAbstractState,
    PlaneState,
    SwarmEvent,
)
from swarmabs_core.plant import PlaneDynamics, SwarmLoad
from swarmabs_core.ranges import RangeMonitor, lane
from swarmabs_core.record import Record
from swarmabs_run.swarm_columns import SwarmColumns, on_columns

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from swarmabs_bag.recording import Step
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message

    Floats = NDArray[np.float64]


Coordinated: TypeAlias = tuple[PlaneState, AbstractState, AuxiliaryState, DesiredAbstractState]
"""The messages of the coordinators in a step, in the order of a bag."""


class NotVectorisableError(Exception):
    """A robot behaves individually from this step on; only the state machines can continue."""


def vectorisable(scenario: Scenario) -> bool:
    """Return whether all robots of a scenario always behave alike and use laws that support arrays.

    If robots may be dropped, each step has a message of the observer more, which arrays do not provide.
    """
    return not scenario.faults and configure.division(scenario) < ALWAYS and on_columns(scenario)


class Motion(NamedTuple):
    """Positions (m), velocities (m/s) and commands of the robots, step by step: (K, N)."""

    position: Floats
    velocity: Floats
    command: Floats


class _Swarm:
    """The robots: their constants, and positions, velocities and commands in the same order."""

    def __init__(self, scenario: Scenario) -> None:
        configs = {config.agent_id: config for config in configure.agent_configs(scenario)}
        self.columns = SwarmColumns(scenario, configs.values())
        self.position = np.array([configs[agent_id].position for agent_id in self.columns.ids])
        self.velocity = np.array([configs[agent_id].velocity for agent_id in self.columns.ids])
        self.command = np.zeros(len(configs))

    def sums(self, step: int, stamp: int) -> tuple[AbstractState, AuxiliaryState]:
        """Return abstract and auxiliary state, as `swarmabs_core.abstraction` defines them."""
        return self.columns.observed(step, stamp, self.position, self.velocity)

    def move(self, abstract: AbstractState, sums: AuxiliaryState, desired: DesiredAbstractState) -> SwarmLoad:
        """Command all robots, move them for one period, and return their load on the plane over it."""
        columns, before = self.columns, (self.position, self.velocity)
        self.command = columns.commands(*before, abstract, sums, desired)
        if not bool(np.isfinite(self.command).all()):
            raise NotVectorisableError
        self.position, self.velocity = columns.moved(*before, self.command)
        return columns.load(before, (self.position, self.velocity))


class _Gathered:
    """The steps since the last block."""

    def __init__(self, swarm: _Swarm) -> None:
        robots, layouts = len(swarm.columns.ids), [LAYOUT[topic].itemsize for topic in MAIN_TOPICS]
        most = max(1, BLOCK_BYTES // (layouts[0] * robots + sum(layouts[1:])))
        self._swarm = swarm
        self._motion = Motion(*(np.empty((most, robots)) for _ in Motion._fields))
        self._messages: list[Coordinated] = []
        self._begun = 0.0

    @property
    def full(self) -> bool:
        """Whether the steps are as many, or as old, as a block may be."""
        return len(self._messages) == len(self._motion.position) or time.monotonic() - self._begun >= BLOCK_SECONDS

    def add(self, messages: Coordinated) -> None:
        """Add the messages of a step and the state of the robots."""
        swarm, place = self._swarm, len(self._messages)
        if not place:
            self._begun = time.monotonic()
        for values, now in zip(self._motion, (swarm.position, swarm.velocity, swarm.command), strict=True):
            values[place] = now
        self._messages.append(messages)

    def take(self, events: list[Message] | None = None) -> Iterator[Step]:
        """Yield the steps as a block, the last one on its own if it has events, and begin the next block."""
        if not self._messages:
            return
        columns = zip(MAIN_TOPICS[1:], zip(*self._messages, strict=True), strict=True)
        tables = {topic: table(topic, b"".join(map(encode, messages))) for topic, messages in columns}
        steps = np.array([plane.step for plane, *_ in self._messages], dtype=np.uint64)
        stamps = np.array([plane.stamp for plane, *_ in self._messages])
        self._messages.clear()
        block = Block({AGENT_STATE: self._swarm.columns.states(steps, stamps, *self._motion), **tables})
        if not events:
            yield block
            return
        if len(block) > 1:
            yield block[:-1]
        (last,) = block[-1:].recorded()
        added = sorted(map(Record.of, events), key=lambda record: record.payload)
        yield last._replace(records=(*last.records, *added))


class VectorSimulation:
    """Simulates a scenario whose robots all behave alike: one for which `vectorisable` holds."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._controller = Controller(
            configure.controller_config(scenario, recording_window=0), configure.parent_controller(scenario)
        )
        self._dynamics = PlaneDynamics(scenario.plane, scenario.period)
        self._swarm = _Swarm(scenario)
        self._ranges = RangeMonitor(lane(scenario.plane.length))

    def steps(self) -> Iterator[Step]:
        """Run, and yield the steps in blocks, a step with events on its own.

        Raises `NotVectorisableError` if a robot has to behave individually; the steps before it are valid. Raises
        `RunError` if the run fails, such as when the plane turns over.
        """
        gathered = _Gathered(self._swarm)
        try:
            for messages, events in self._messages():
                gathered.add(messages)
                if events or gathered.full:
                    yield from gathered.take(events)
        except Exception:
            yield from gathered.take()
            raise
        yield from gathered.take()

    def _messages(self) -> Iterator[tuple[Coordinated, list[Message]]]:
        """Yield the messages of the coordinators and the events of every step, while the robots are at that step."""
        scenario, swarm = self._scenario, self._swarm
        angle, angular_velocity = scenario.plane.angle, scenario.plane.angular_velocity
        length = scenario.plane.length
        for step in range(scenario.steps + 1):
            stamp = step * scenario.step_ns
            abstract, sums = swarm.sums(step, stamp)
            plane = PlaneState(stamp, step, angle, angular_velocity)
            answers = self._controller.handle(plane)
            desired = answers[-1]
            assert isinstance(desired, DesiredAbstractState)  # noqa: S101 - the last message of the controller
            yield (plane, abstract, sums, desired), [*self._crossings(step, stamp), *answers[:-1]]
            if step == scenario.steps:
                return
            if is_degenerate(sums.s0, sums.s3, length):
                raise NotVectorisableError
            load = swarm.move(abstract, sums, desired)
            angle, angular_velocity = self._dynamics.advance(angle, angular_velocity, stamp / 1e9, load)

    def _crossings(self, step: int, stamp: int) -> list[SwarmEvent]:
        """Return an event for each robot that has just crossed an end of the plane."""
        position = self._swarm.position
        if self._ranges.quiet(float(np.abs(position).max())):
            return []
        places = zip(self._swarm.columns.ids, position.tolist(), strict=True)
        return self._ranges.watch([(robot, (place,)) for robot, place in places], step, stamp)
