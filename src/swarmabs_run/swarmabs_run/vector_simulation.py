"""Simulation of large swarms with all robots on arrays, bit for bit identical to the state machines.

Addition, multiplication and division round each array element exactly as they round scalars, and every sum over the
robots is correctly rounded; no other function is applied to arrays. So the same formulas give the same bits, and tests
check this. Events of single robots (faults, limits, safe stops), imperfect sensors and drives, end stops and observers
of the plane are left to the state machines.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarmabs_bag.recording import digest_head
from swarmabs_config import configure
from swarmabs_core.abstraction import is_degenerate, summed
from swarmabs_core.arrays import LAYOUT
from swarmabs_core.behaviours import Controller
from swarmabs_core.cdr import ENCAPSULATION, FRAME, decode
from swarmabs_core.drive import DoubleIntegratorDrive, SingleIntegratorDrive
from swarmabs_core.messages import (
    AGENT_STATE,
    EVENTS,
    MAIN_TOPICS,
    NEVER,
    AbstractState,
    AgentState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Kind,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.parent_response import SumObserver
from swarmabs_core.plant import PlaneDynamics, SwarmLoad, column_load
from swarmabs_core.record import Record
from swarmabs_core.robot_controller import Limits
from swarmabs_core.summation import column_sums
from swarmabs_core.swarm_law import PAPER, double_integrator_command, single_integrator_command

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message, Topic

_PAYLOAD = LAYOUT[AGENT_STATE]
_HEAD = digest_head(AGENT_STATE, _PAYLOAD.itemsize)
_DIGESTED = np.dtype([("head", f"V{len(_HEAD)}"), ("payload", _PAYLOAD)])


class NotVectorisableError(Exception):
    """A robot behaves individually from this step on; only the state machines can continue."""


def vectorisable(scenario: Scenario) -> bool:
    """Return whether all robots of a scenario always behave alike and use laws that support arrays."""
    limits, plane, swarm = scenario.limits, scenario.plane, scenario.swarm
    individual = scenario.faults or limits != Limits() or plane.robot_gravity
    perfect = plane.sensor.perfect and swarm.sensor.perfect
    special = plane.end_stop < inf or swarm.actuator_lag or scenario.observer.type != SumObserver.type
    return perfect and swarm.law.type == PAPER.name and not (individual or special)


class ArrayStep(NamedTuple):
    """A step whose robots are rows of an array; the other messages are records."""

    step: int
    stamp: int
    agents: NDArray[np.void]
    others: tuple[Record, ...]

    @property
    def messages(self) -> int:
        """Number of messages."""
        return len(self.agents) + len(self.others)

    @property
    def parent(self) -> PlaneState:
        """State of the plane."""
        plane = self.others[0].message
        assert isinstance(plane, PlaneState)  # noqa: S101 - the records are in the order of a bag
        return plane

    @property
    def parents(self) -> tuple[PlaneState, ...]:
        """State of the plane."""
        return (self.parent,)

    @property
    def max_abs_positions(self) -> tuple[float, ...]:
        """Largest distance of a robot from the axis, m."""
        return (float(np.abs(self.agents["payload"]["position"]).max()),)

    @property
    def events(self) -> tuple[SwarmEvent, ...]:
        """Events of the step."""
        return tuple(r.message for r in self.others[len(MAIN_TOPICS) - 1 :] if isinstance(r.message, SwarmEvent))

    def states(self) -> Iterator[AgentState]:
        """Return the robots' states."""
        size = _PAYLOAD.itemsize
        data = self.agents["payload"].tobytes()
        for start in range(0, len(data), size):
            state = decode(AgentState, data[start : start + size])
            assert isinstance(state, AgentState)  # noqa: S101 - `decode` returns this type
            yield state

    def digest_text(self) -> bytes:
        """Return the contribution of the step to the digest of a run."""
        parts = {AGENT_STATE.name: self.agents.tobytes()}
        for record in self.others:
            if record.topic is not EVENTS:
                parts[record.topic.name] = digest_head(record.topic, len(record.payload)) + record.payload
        return b"".join(parts[name] for name in sorted(parts))

    def stored(self) -> Iterator[tuple[Topic, int, bytes]]:
        """Return topic, time (ns) and bytes of every message, in the order of a bag."""
        data = self.agents["payload"].tobytes()
        size = _PAYLOAD.itemsize
        for start in range(0, len(data), size):
            yield AGENT_STATE, self.stamp, data[start : start + size]
        for record in self.others:
            yield record.topic, self.stamp, record.payload


class _Swarm:
    """The robots: single integrators first, then double integrators, so that each kind is a slice of every array."""

    def __init__(self, scenario: Scenario) -> None:
        configs = sorted(configure.agent_configs(scenario), key=lambda config: (config.kind, config.agent_id))
        self.period = scenario.period
        self.gravity = scenario.plane.gravity
        self.gains = configs[0].gains
        self.ids = [config.agent_id for config in configs]
        self.mass = np.array([config.mass for config in configs])
        self.position = np.array([config.position for config in configs])
        self.velocity = np.array([config.velocity for config in configs])
        self.command = np.zeros(len(configs))
        damped = [config for config in configs if config.kind is Kind.DOUBLE_INTEGRATOR]
        single = len(configs) - len(damped)
        self.si, self.di = slice(single), slice(single, None)
        self.di_damping = np.array([config.damping for config in damped])
        drives = [DoubleIntegratorDrive.of(scenario.period, config.mass, config.damping) for config in damped]
        # Drives, laws and paths use arithmetic only, so they accept arrays in place of numbers.
        self.si_drive: Any = SingleIntegratorDrive(scenario.period)
        self.di_drive: Any = DoubleIntegratorDrive(*np.array(drives).reshape(-1, 4).T.copy())
        self.by_id = np.argsort(self.ids)
        self.rows = np.zeros(len(configs), dtype=_DIGESTED)
        self.rows["head"] = np.void(_HEAD)
        payload = self.rows["payload"]
        payload["encapsulation"] = np.void(ENCAPSULATION)
        payload["frame"] = np.void(FRAME)
        payload["agent_id"] = self.ids
        payload["kind"] = [config.kind for config in configs]
        payload["status"] = Status.ACTIVE
        payload["mass"] = self.mass
        payload["damping"][self.di] = self.di_damping

    def states(self, step: int, stamp: int) -> NDArray[np.void]:
        """Return the robots' messages of a step, by ascending id."""
        payload = self.rows["payload"]
        payload["sec"], payload["nanosec"] = divmod(stamp, 1_000_000_000)
        payload["step"] = step
        payload["broadcast_step"] = step - 1 if step else NEVER
        payload["position"] = self.position
        payload["velocity"] = self.velocity
        payload["command"] = self.command
        return self.rows[self.by_id]

    def sums(self, step: int, stamp: int) -> tuple[AbstractState, AuxiliaryState]:
        """Return abstract and auxiliary state, as `swarmabs_core.abstraction` defines them."""
        m, p, di = self.mass, self.position, self.di
        robots = (m, p, self.velocity), (m, p), (m[di], p[di], self.di_damping)
        return summed(stamp, step, len(m), robots, (self.gravity, self.gains.ksd), column_sums)

    def move(self, abstract: AbstractState, sums: AuxiliaryState, desired: DesiredAbstractState) -> SwarmLoad:
        """Command all robots, move them for one period, and return their load on the plane over it."""
        si, di = self.si, self.di
        m, p, v = self.mass, self.position.copy(), self.velocity.copy()
        law_si: Any = single_integrator_command
        law_di: Any = double_integrator_command
        common = (self.gains, self.gravity, abstract, sums, desired)
        self.command[si] = law_si(m[si], p[si], *common)
        self.command[di] = law_di(m[di], self.di_damping, p[di], v[di], *common)
        u = self.command
        if not bool(np.isfinite(u).all()):
            raise NotVectorisableError
        self.position[si], self.velocity[si] = self.si_drive.advance(p[si], v[si], u[si])
        self.position[di], self.velocity[di] = self.di_drive.advance(p[di], v[di], u[di])
        return column_load(m, (p, v), (self.position, self.velocity), di, (self.period, self.gravity))


class VectorSimulation:
    """Simulates a scenario whose robots all behave alike: one for which `vectorisable` holds."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._controller = Controller(
            configure.controller_config(scenario, recording_window=0), configure.parent_controller(scenario)
        )
        self._dynamics = PlaneDynamics(scenario.plane, scenario.period)
        self._swarm = _Swarm(scenario)
        self._outside: set[int] = set()

    def steps(self) -> Iterator[ArrayStep]:
        """Run, and yield every step.

        Raises `NotVectorisableError` if a robot has to behave individually; the steps before it are valid. Raises
        `RunError` if the run fails, such as when the plane turns over.
        """
        scenario, swarm = self._scenario, self._swarm
        angle, angular_velocity = scenario.plane.angle, scenario.plane.angular_velocity
        length = scenario.plane.length
        for step in range(scenario.steps + 1):
            stamp = step * scenario.step_ns
            rows = swarm.states(step, stamp)
            abstract, sums = swarm.sums(step, stamp)
            plane = PlaneState(stamp, step, angle, angular_velocity)
            answers = self._controller.handle(plane)
            desired = answers[-1]
            assert isinstance(desired, DesiredAbstractState)  # noqa: S101 - the last message of the controller
            events: list[Message] = [*self._limits(step, stamp), *answers[:-1]]
            yield ArrayStep(step, stamp, rows, _records(plane, abstract, sums, desired, events))
            if step == scenario.steps:
                return
            if is_degenerate(sums.s0, sums.s3, length):
                raise NotVectorisableError
            load = swarm.move(abstract, sums, desired)
            time = step * scenario.step_ns / 1e9
            angle, angular_velocity = self._dynamics.advance(angle, angular_velocity, time, load)

    def _limits(self, step: int, stamp: int) -> list[SwarmEvent]:
        """Return an event for each robot that has just crossed the end of the plane."""
        position, half = self._swarm.position, 0.5 * self._scenario.plane.length
        if not self._outside and np.abs(position).max() <= half:
            return []
        outside = {self._swarm.ids[i]: float(position[i]) for i in np.flatnonzero(np.abs(position) > half)}
        new = sorted(outside.keys() - self._outside)
        self._outside = set(outside)
        return [
            SwarmEvent(stamp, step, agent_id, EventKind.LIMIT_HIT, outside[agent_id], "off the plane's end")
            for agent_id in new
        ]


def _records(
    plane: PlaneState,
    abstract: AbstractState,
    sums: AuxiliaryState,
    desired: DesiredAbstractState,
    events: list[Message],
) -> tuple[Record, ...]:
    """Return the records of the coordinators in the order of a bag."""
    main = [Record.of(message) for message in (plane, abstract, sums, desired)]
    return (*main, *sorted(map(Record.of, events), key=lambda record: record.payload))
