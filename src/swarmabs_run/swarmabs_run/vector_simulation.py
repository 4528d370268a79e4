"""The simulation of large swarms: all robots on arrays, bit for bit what the state machines do.

Addition, multiplication and division of arrays round element by element exactly as those of numbers do, and every sum
over the robots is correctly rounded; no other function is applied to arrays. So the same formulas give the same bits,
which is a test. What concerns single robots (faults, limits, safe stops), imperfect sensors and drives, end stops and
observers of the plane are left to the state machines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from swarmabs_bag.recording import Record, digest_head
from swarmabs_config import configure
from swarmabs_core.abstraction import is_degenerate
from swarmabs_core.arrays import LAYOUT
from swarmabs_core.behaviours import Controller
from swarmabs_core.cdr import ENCAPSULATION, FRAME, agent_id_of, encode
from swarmabs_core.drive import DoubleIntegratorDrive
from swarmabs_core.law_registry import PAPER
from swarmabs_core.messages import (
    AGENT_STATE,
    EVENTS,
    MAIN_TOPICS,
    NEVER,
    TOPIC_OF,
    AbstractState,
    AuxiliaryState,
    DesiredAbstractState,
    EventKind,
    Kind,
    PlaneState,
    Status,
    SwarmEvent,
)
from swarmabs_core.plant import Disturbance, PlaneDynamics, SwarmLoad
from swarmabs_core.summation import exact_sum
from swarmabs_core.swarm_law import double_integrator_command, single_integrator_command

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from swarmabs_config.scenario import Scenario
    from swarmabs_core.messages import Message, Topic

    Floats = NDArray[np.float64]

_PAYLOAD = LAYOUT[AGENT_STATE]
_HEAD = digest_head(AGENT_STATE, _PAYLOAD.itemsize)
_DIGESTED = np.dtype([("head", f"V{len(_HEAD)}"), ("payload", _PAYLOAD)])


class NotVectorisableError(Exception):
    """A robot does something of its own from this step on; only the state machines can go on."""


def vectorisable(scenario: Scenario) -> bool:
    """Tell whether all robots of a scenario do the same all the time, by the laws that are computed on arrays."""
    limits, plane, swarm = scenario.limits, scenario.plane, scenario.swarm
    individual = scenario.faults or limits.velocity or limits.force or plane.robot_gravity
    perfect = configure.plane_sensor(scenario).perfect and configure.robot_sensor(scenario).perfect
    special = plane.end_stop or swarm.actuator_lag or configure.parent_model(scenario)
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
    def plane(self) -> PlaneState:
        """State of the plane."""
        plane = self.others[0].message
        assert isinstance(plane, PlaneState)  # noqa: S101 - the records have the order of a bag
        return plane

    @property
    def max_abs_position(self) -> float:
        """Largest distance of a robot from the axis, m."""
        return float(np.abs(self.agents["payload"]["position"]).max())

    @property
    def events(self) -> tuple[SwarmEvent, ...]:
        """What happened in it."""
        return tuple(r.message for r in self.others[len(MAIN_TOPICS) - 1 :] if isinstance(r.message, SwarmEvent))

    def digest_text(self) -> bytes:
        """Return what the step contributes to the digest of a run."""
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
    """The robots by ascending id, single integrators and double integrators also apart."""

    def __init__(self, scenario: Scenario) -> None:
        configs = configure.agent_configs(scenario)
        self.period = scenario.period
        self.gravity = scenario.plane.gravity
        self.gains = configs[0].gains
        self.ids = [config.agent_id for config in configs]
        self.mass = np.array([config.mass for config in configs])
        self.position = np.array([config.position for config in configs])
        self.velocity = np.array([config.velocity for config in configs])
        self.command = np.zeros(len(configs))
        kinds = np.array([config.kind for config in configs])
        self.si = np.flatnonzero(kinds == Kind.SINGLE_INTEGRATOR)
        self.di = np.flatnonzero(kinds == Kind.DOUBLE_INTEGRATOR)
        self.di_damping = np.array([configs[i].damping for i in self.di])
        drives = [DoubleIntegratorDrive(scenario.period, configs[i].mass, configs[i].damping) for i in self.di]
        self.decay = np.array([drive.decay for drive in drives])
        self.force_to_velocity = np.array([drive.force_to_velocity for drive in drives])
        self.velocity_to_position = np.array([drive.velocity_to_position for drive in drives])
        self.force_to_position = np.array([drive.force_to_position for drive in drives])
        self.rows = np.zeros(len(configs), dtype=_DIGESTED)
        self.rows["head"] = np.void(_HEAD)
        payload = self.rows["payload"]
        payload["encapsulation"] = np.void(ENCAPSULATION)
        payload["frame"] = np.void(FRAME)
        payload["agent_id"] = self.ids
        payload["kind"] = kinds
        payload["status"] = Status.ACTIVE
        payload["mass"] = self.mass
        payload["damping"][self.di] = self.di_damping

    def states(self, step: int, stamp: int) -> NDArray[np.void]:
        """Return the robots' messages of a step."""
        rows: NDArray[np.void] = self.rows.copy()
        payload = rows["payload"]
        payload["sec"], payload["nanosec"] = divmod(stamp, 1_000_000_000)
        payload["step"] = step
        payload["broadcast_step"] = step - 1 if step else NEVER
        payload["position"] = self.position
        payload["velocity"] = self.velocity
        payload["command"] = self.command
        return rows

    def sums(self, step: int, stamp: int) -> tuple[AbstractState, AuxiliaryState]:
        """Return abstract and auxiliary state, as `swarmabs_core.abstraction` defines them."""
        m, p, v, g = self.mass, self.position, self.velocity, self.gravity
        mm, mp, mv = m * m, m * p, m * v
        s0, s1 = _sum(mm), _sum(mm * p)
        offset = p - (s1 / s0 if s0 else 0.0)
        s3 = s0 * _sum(mm * offset * offset)
        p_di = p[self.di]
        mc = m[self.di] * (self.di_damping + self.gains.ksd)
        mcp = mc * p_di
        return (
            AbstractState(stamp, step, len(m), g * _sum(mp), _sum(mp * p), g * _sum(mv), 2.0 * _sum(mp * v)),
            AuxiliaryState(
                stamp, step, s0, s1, _sum(mm * p * p), s3, _sum(mc), _sum(mcp), _sum(mcp * p_di), _sum(mv * v)
            ),
        )

    def move(self, abstract: AbstractState, sums: AuxiliaryState, desired: DesiredAbstractState) -> SwarmLoad:
        """Command all robots, move them for a period, and return what the plane feels meanwhile."""
        si, di = self.si, self.di
        m, p, v = self.mass, self.position.copy(), self.velocity.copy()
        # The laws are arithmetic only, so they take arrays as they take numbers.
        law_si: Any = single_integrator_command
        law_di: Any = double_integrator_command
        common = (self.gains, self.gravity, abstract, sums, desired)
        self.command[si] = law_si(m[si], p[si], *common)
        self.command[di] = law_di(m[di], self.di_damping, p[di], v[di], *common)
        u = self.command
        if not bool(np.isfinite(u).all()):
            raise NotVectorisableError
        self.position[si] = p[si] + u[si] * self.period
        self.velocity[si] = u[si]
        self.position[di] = p[di] + self.velocity_to_position * v[di] + self.force_to_position * u[di]
        self.velocity[di] = self.decay * v[di] + self.force_to_velocity * u[di]
        return self._load(p, v)

    def _load(self, p0: Floats, v0: Floats) -> SwarmLoad:
        """Return torque and inertia over the period, as `swarmabs_core.plant` defines them."""
        m, di, g = self.mass, self.di, self.gravity
        b = self.position - p0
        rise = b[di]
        d0, d1 = v0[di] * self.period, self.velocity[di] * self.period
        b[di] = d0
        c, d = 3.0 * rise - 2.0 * d0 - d1, d0 + d1 - 2.0 * rise
        ma, mb = m * p0, m * b
        ma_di, mb_di, mc, md = ma[di], mb[di], m[di] * c, m[di] * d
        return SwarmLoad(
            (g * _sum(ma), g * _sum(mb), g * _sum(mc), g * _sum(md)),
            (
                _sum(ma * p0),
                _sum(2.0 * ma * b),
                exact_sum([*(mb * b).tolist(), *(2.0 * ma_di * c).tolist()]),
                _sum(2.0 * (ma_di * d + mb_di * c)),
                _sum(mc * c + 2.0 * mb_di * d),
                _sum(2.0 * mc * d),
                _sum(md * d),
            ),
        )


def _sum(terms: Floats) -> float:
    return exact_sum(terms.tolist())


class VectorSimulation:
    """Simulates a scenario whose robots all do the same.

    Parameters
    ----------
    scenario : Scenario
        A scenario for which `vectorisable` holds.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        plane = scenario.plane
        self._controller = Controller(
            configure.controller_config(scenario, recording_window=0), configure.parent_controller(scenario)
        )
        self._dynamics = PlaneDynamics(
            inertia=plane.inertia,
            friction=configure.friction(scenario),
            disturbance=Disturbance(plane.disturbance.amplitude, plane.disturbance.angular_frequency),
            period=scenario.period,
            substep=plane.substep,
        )
        self._swarm = _Swarm(scenario)
        self._outside: set[int] = set()

    def steps(self) -> Iterator[ArrayStep]:
        """Run, and yield every step.

        Raises
        ------
        NotVectorisableError
            If a robot has to do something of its own; the steps up to there are right.
        RunError
            If the run fails, such as by a plane that turns over.
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
            assert isinstance(desired, DesiredAbstractState)  # noqa: S101 - it is what the controller answers last
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
        """Say which robots have just crossed the end of the plane."""
        position = self._swarm.position
        beyond = np.flatnonzero(np.abs(position) > 0.5 * self._scenario.plane.length)
        if not len(beyond) and not self._outside:
            return []
        outside = {self._swarm.ids[i]: float(position[i]) for i in beyond}
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

    def record(message: Message, agent_id: int = 0) -> Record:
        return Record(TOPIC_OF[type(message)], agent_id, message, encode(message))

    told = [record(event, agent_id_of(event)) for event in events]
    return (record(plane), record(abstract), record(sums), record(desired), *sorted(told, key=lambda r: r.payload))
