"""The robots of a swarm on any parent system as columns, with the parent, one step after the other."""

from __future__ import annotations

from functools import partial
from itertools import groupby
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from swarmabs_config import configure
from swarmabs_core.arrays import layout_of
from swarmabs_core.cdr import encode
from swarmabs_core.errors import SwarmabsError
from swarmabs_core.messages import NEVER, ROBOT_STATE, SYSTEM_FAMILY, Status, word
from swarmabs_core.models import SystemAgentConfig
from swarmabs_core.summation import column_total
from swarmabs_core.systems.columns import SystemOnColumns, column, columns, dynamics_of
from swarmabs_core.systems.swarm import observed
from swarmabs_run.swarm_columns import NotVectorisableError, only_controlled, rows_of_steps

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from swarmabs_config.scenario import SystemScenario
    from swarmabs_core.messages import (
        AnyBroadcast,
        ParentState,
        RobotState,
        SwarmAbstract,
        SwarmAuxiliary,
        SwarmBroadcast,
    )
    from swarmabs_core.models import SystemParentConfig

    Floats = NDArray[np.float64]

ReturnT = TypeVar("ReturnT")


def system_on_columns(scenario: SystemScenario) -> bool:
    """Return whether the robots of a scenario, apart from faults, behave alike on a system that supports columns."""
    return bool(getattr(scenario.named.instance, "columns", False)) and only_controlled(scenario.family)


def _add(terms: Iterable[Any]) -> float:
    return column_total(*terms)


class _Kind:
    """The robots of one kind: their law, their state, and the limits of their commands, d columns each."""

    def __init__(self, system: SystemOnColumns, configs: Sequence[SystemAgentConfig]) -> None:
        first, laws = configs[0], [config.law() for config in configs]
        self.ids = [config.agent_id for config in configs]
        self.law = laws[0].on(system.instance, dynamics_of([law.dynamics for law in laws]))
        states = [config.body().state(0, NEVER, Status.ACTIVE) for config in configs]
        self.state: RobotState = states[0]._replace(
            coordinates=column(state.coordinates for state in states),
            velocities=column(state.velocities for state in states),
            command=column(state.command for state in states),
            constants=self.law.dynamics.constants,
        )
        self.rows = list(map(encode, states))
        limits = getattr(system.instance, "limits", None)
        ends_of_robots = [limits(config.constants, word(first.kind)) for config in configs] if limits else []
        self._limits = tuple(zip(*(column(ends) for ends in zip(*ends_of_robots, strict=True)), strict=True))

    def moved(self, heard: AnyBroadcast) -> RobotState:
        """Return the state one period later, under the commands that follow from the broadcasts."""
        law, state = self.law, self.state
        rate = law.rate(state.coordinates, state.velocities, cast("SwarmBroadcast", heard))
        if rate is None or not np.isfinite(rate).all():
            raise NotVectorisableError
        command = columns(law.command(state.coordinates, state.velocities, rate), state.coordinates)
        if any((u < low).any() or (u > high).any() for u, (low, high) in zip(command, self._limits, strict=False)):
            raise NotVectorisableError
        q, velocity = law.advance(state.coordinates, state.velocities, command)
        return state._replace(coordinates=q, velocities=velocity, command=command)


class SystemSwarm:
    """Robots on any parent system, as `swarmabs_run.vector_simulation.Swarm`."""

    family = SYSTEM_FAMILY

    def __init__(self, scenario: SystemScenario) -> None:
        system = SystemOnColumns(scenario.named.type, scenario.named.settings)
        configs = sorted(configure.agent_configs(scenario), key=lambda config: (config.kind, config.agent_id))
        self._system = system
        self._kinds = [_Kind(system, [*group]) for _, group in groupby(configs, key=lambda config: config.kind)]
        self._curvature = configure.observer_config(scenario).curvature  # type: ignore[union-attr]  # of a system
        parent = cast("SystemParentConfig", configure.parent_config(scenario))
        self._parent = parent.motion(system, _add)
        self._period_ns = scenario.step_ns
        self.ids = [agent_id for kind in self._kinds for agent_id in kind.ids]
        self.ranges = system.instance.robot
        self._by_id = np.argsort(self.ids)
        payloads = [payload for kind in self._kinds for payload in kind.rows]
        rows = np.frombuffer(b"".join(payloads), layout_of(ROBOT_STATE, payloads[0]))
        self._rows = rows[self._by_id]
        self.size = rows.nbytes

    def observed(self, step: int, stamp: int) -> tuple[SwarmAbstract, SwarmAuxiliary]:
        """Return abstract and auxiliary state."""
        with np.errstate(all="ignore"):
            states, count = [kind.state for kind in self._kinds], len(self.ids)
            sums = partial(observed, self._system, stamp, step, states, curvature=self._curvature)
            abstract, auxiliary = self._individual(partial(sums, count=count, add=_add))
        if not all(map(isfinite, (*abstract.value, *abstract.rate, *auxiliary.gram, *auxiliary.drift))):
            raise NotVectorisableError  # rounding of what is not finite is not the same
        return abstract, auxiliary

    def parent(self, step: int, stamp: int) -> ParentState:  # noqa: ARG002 - the parent knows its period
        """Return the measured state of the parent."""
        return self._parent.state(step)

    def move(self, heard: AnyBroadcast) -> None:
        """Command all robots by the broadcasts of a step, and move them and the parent for one period."""
        with np.errstate(all="ignore"):
            moved = [self._individual(partial(kind.moved, heard)) for kind in self._kinds]
            pairs = [(kind.state, after) for kind, after in zip(self._kinds, moved, strict=True)]
            self._parent.advance(heard.stamp // self._period_ns + 1, pairs, 0.0)
        for kind, after in zip(self._kinds, moved, strict=True):
            kind.state = after

    def places(self) -> Floats:
        """Return the coordinates of the robots, (N, d)."""
        return np.concatenate([np.array(kind.state.coordinates).T for kind in self._kinds])

    def motion(self) -> list[RobotState]:
        """Return the states of all kinds."""
        return [kind.state for kind in self._kinds]

    def states(
        self, steps: NDArray[np.uint64], stamps: NDArray[np.int64], motions: Sequence[list[RobotState]]
    ) -> NDArray[np.void]:
        """Return the robots' messages of K steps with their stamps (ns), by step and ascending id: (K, N)."""
        rows = rows_of_steps(self._rows, steps, stamps)
        for name in ("coordinates", "velocities", "command"):
            parts = [np.array([getattr(state, name) for state in states]) for states in zip(*motions, strict=True)]
            rows[name] = np.concatenate(parts, axis=2).transpose(0, 2, 1)[:, self._by_id]
        return rows

    def _individual(self, function: Callable[[], ReturnT]) -> ReturnT:
        """Call a function of robots; if it fails, the state machines can tell of which robot."""
        try:
            return function()
        except SwarmabsError:
            raise
        except Exception as error:
            raise NotVectorisableError from error
