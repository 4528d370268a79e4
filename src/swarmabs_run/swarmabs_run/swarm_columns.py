"""The robots of a swarm on the plane as columns: laws, motion, load and sums of all robots in many steps at once.

Addition, multiplication and division round each array element exactly as they round scalars, and every sum over the
robots is correctly rounded; no other function is applied to arrays. So the same formulas give the same bits, and tests
check this. Events of single robots (faults, limits, safe stops), imperfect sensors and drives, end stops and observers
of the plane are left to the state machines.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from swarmabs_config import configure
from swarmabs_config.publishers import PUBLISHER
from swarmabs_core.abstraction import summed
from swarmabs_core.arrays import LAYOUT
from swarmabs_core.cdr import ENCAPSULATION, FRAME, SECOND
from swarmabs_core.drive import DoubleIntegratorDrive, SingleIntegratorDrive
from swarmabs_core.messages import AGENT_STATE, Status
from swarmabs_core.nodes import CONTROLLER
from swarmabs_core.parent_response import SumObserver
from swarmabs_core.plant import column_load
from swarmabs_core.robot_controller import Limits
from swarmabs_core.summation import column_sums, column_total, exact_sum
from swarmabs_core.swarm_law import PAPER, double_integrator_command, single_integrator_command

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from swarmabs_config.scenario import PlaneScenario
    from swarmabs_core.messages import AbstractState, AuxiliaryState, Family
    from swarmabs_core.models import AgentConfig
    from swarmabs_core.plant import SwarmLoad
    from swarmabs_core.summation import Reduction, Sums, Terms

Floats: TypeAlias = "NDArray[np.float64]"


class NotVectorisableError(Exception):
    """A robot behaves individually from this step on; only the state machines can continue."""


def on_columns(scenario: PlaneScenario) -> bool:
    """Return whether the robots of a scenario, apart from faults, behave alike and use laws that support arrays."""
    plane, swarm = scenario.plane, scenario.swarm
    perfect = plane.sensor.perfect and swarm.sensor.perfect
    individual = scenario.limits != Limits() or plane.robot_gravity or swarm.actuator_lag
    special = plane.end_stop < inf or scenario.observer.type != SumObserver.type or not only_controlled(scenario.family)
    return perfect and swarm.law.type == PAPER.name and not (individual or special)


def only_controlled(family: Family) -> bool:
    """Return whether only the controller, a state machine also beside arrays, publishes on further topics."""
    return all(PUBLISHER[topic] == CONTROLLER for topic in family.further)


def step_total(*columns: Floats) -> Floats:
    """Return the correctly rounded sums over the robots of columns (N, K), (K,)."""
    joined = columns[0] if len(columns) == 1 else np.concatenate(columns)
    return np.array([exact_sum(robots) for robots in joined.T.tolist()])


def step_sums(robots: Iterable[Floats], terms: Terms, reduction: Reduction) -> list[Any]:
    """Return what a reduction gives for robots given as columns (N, K), or (N, 1): (K,) for each number."""
    columns = np.broadcast_arrays(*terms(*robots))
    steps = zip(*(column.T.tolist() for column in columns), strict=True)
    return list(np.array([reduction(columns) for columns in steps]).T)


def rows_of_steps(robots: NDArray[np.void], steps: NDArray[np.uint64], stamps: NDArray[np.int64]) -> NDArray[np.void]:
    """Return the robots' states, (N,), with the numbers and stamps (ns) of K steps: (K, N)."""
    rows = np.repeat(robots[np.newaxis], len(steps), axis=0)
    rows["sec"], rows["nanosec"] = (part[:, np.newaxis] for part in np.divmod(stamps, SECOND))
    rows["step"] = steps[:, np.newaxis]
    rows["broadcast_step"] = steps[:, np.newaxis] - np.uint64(1)  # `NEVER` in step 0
    return rows


class Standing(NamedTuple):
    """Robots that stand on the plane: ids, masses (kg) as a column, and positions (m) as those of the others."""

    ids: list[int]
    mass: Floats
    position: Floats


class SwarmColumns:
    """The constants of N robots: single integrators first, then double integrators, so that each kind is a slice.

    Positions, velocities and commands are columns (N,) in this order; with `steps` those of K steps, (N, K), and what
    is one number for all robots is (K,).

    Attributes
    ----------
    ids : list of int
        Ids of the robots.
    by_id : ndarray of int
        Places of the robots by ascending id; `places` is the inverse.
    mass : ndarray
        Masses, kg.
    """

    def __init__(self, scenario: PlaneScenario, configs: Iterable[AgentConfig], *, steps: bool = False) -> None:
        ordered = sorted(configs, key=lambda config: (config.kind, config.agent_id))
        damped = [config for config in ordered if config.kind.by_force]
        single = len(ordered) - len(damped)
        shape = (-1, 1) if steps else (-1,)
        self._sums: Sums = step_sums if steps else column_sums
        self._total = step_total if steps else column_total
        self.ids = [config.agent_id for config in ordered]
        self.by_id = np.argsort(self.ids)
        self.places = np.argsort(self.by_id)
        self.mass = np.array([config.mass for config in ordered]).reshape(shape)
        self._si, self._di = slice(single), slice(single, len(ordered))
        self._damping = np.array([config.damping for config in damped]).reshape(shape)
        self._constants = scenario.period, scenario.plane.gravity
        self._gravity = scenario.plane.gravity
        self._heights = configure.parent_config(scenario).heights
        self._gains = ordered[0].gains
        drives = [DoubleIntegratorDrive.of(scenario.period, config.mass, config.damping) for config in damped]
        factors = np.array(drives).reshape(-1, 4).T.copy()
        # Drives, laws and paths use arithmetic only, so they accept arrays in place of numbers.
        self._si_drive: Any = SingleIntegratorDrive(scenario.period)
        self._di_drive: Any = DoubleIntegratorDrive(*(factor.reshape(shape) for factor in factors))
        rows = np.zeros(len(ordered), dtype=LAYOUT[AGENT_STATE])
        rows["encapsulation"], rows["frame"] = np.void(ENCAPSULATION), np.void(FRAME)
        rows["agent_id"] = self.ids
        rows["kind"] = [config.kind for config in ordered]
        rows["status"] = Status.ACTIVE
        rows["mass"] = [config.mass for config in ordered]
        rows["damping"] = [config.damping for config in ordered]
        self._rows = rows[self.by_id]

    def states(self, steps: NDArray[np.uint64], stamps: NDArray[np.int64], *motion: Floats) -> NDArray[np.void]:
        """Return the robots' messages of K steps with their stamps (ns), by step and ascending id: (K, N).

        The motion is given by positions (m), velocities (m/s) and commands, (K, N) in the order of the columns.
        """
        rows = rows_of_steps(self._rows, steps, stamps)
        for name, values in zip(("position", "velocity", "command"), motion, strict=True):
            rows[name] = values[: len(steps), self.by_id]
        return rows

    def observed(
        self, step: Any, stamp: Any, p: Floats, v: Floats, standing: Standing | None = None
    ) -> tuple[AbstractState, AuxiliaryState]:
        """Return abstract and auxiliary state, as `swarmabs_core.abstraction` defines them.

        Robots that stand add to the others.
        """
        m, di = self.mass, self._di
        weights = (m, p, v) if standing is None else _with((m, p, v), standing)
        robots = weights, (m, p), (m[di], p[di], self._damping)
        return summed(stamp, step, len(weights[0]), robots, (self._gravity, self._gains.ksd), self._sums)

    def commands(self, p: Floats, v: Floats, abstract: Any, auxiliary: Any, desired: Any) -> Floats:
        """Return the commands of the robots' laws."""
        si, di, m = self._si, self._di, self.mass
        law_si: Any = single_integrator_command
        law_di: Any = double_integrator_command
        common = (self._gains, self._gravity, abstract, auxiliary, desired)
        commands = np.empty_like(p)
        commands[si] = law_si(m[si], p[si], *common)
        commands[di] = law_di(m[di], self._damping, p[di], v[di], *common)
        return commands

    def moved(self, p: Floats, v: Floats, command: Floats) -> tuple[Floats, Floats]:
        """Return positions and velocities one period later."""
        si, di, p1, v1 = self._si, self._di, p.copy(), v.copy()
        p1[si], v1[si] = self._si_drive.advance(p[si], v[si], command[si])
        p1[di], v1[di] = self._di_drive.advance(p[di], v[di], command[di])
        return p1, v1

    def load(self, before: Sequence[Floats], after: Sequence[Floats], standing: Standing | None = None) -> SwarmLoad:
        """Return the load over a period from positions and velocities at both ends; `standing` as above."""
        mass, ids = self.mass, self.ids
        if standing is not None:
            mass, *before = _with((mass, *before), standing)
            _, *after = _with((self.mass, *after), standing)
            ids = [*ids, *standing.ids]
        heights = None
        if self._heights is not None:
            column = np.array([self._heights[agent_id] for agent_id in ids]).reshape(mass.shape)
            heights = np.broadcast_to(column, before[0].shape)
        return column_load(mass, before, after, self._di, self._constants, self._total, heights)


def _with(robots: tuple[Floats, ...], standing: Standing) -> tuple[Floats, ...]:
    """Return masses, positions and velocities of robots, followed by those of others that stand."""
    also = (standing.mass, standing.position, np.zeros_like(standing.position))
    return tuple(np.concatenate(pair) for pair in zip(robots, also, strict=True))
