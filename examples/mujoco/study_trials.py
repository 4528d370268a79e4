"""Trials of the study: a closed loop on a rig with an imperfection."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from mujoco_setup import Setup, rig_of
from mujoco_trial import SETTLED, judged
from mujoco_world import OVERHANG
from virtual_swarm import State, Swarm

from swarmabs_config.scenario import PlaneScenario, on_plane
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.abstraction import second_moments
from swarmabs_core.messages import AbstractState, PlaneState
from swarmabs_core.parent_response import TorqueEstimator

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from mujoco_rig import MujocoRig

    from swarmabs_core.messages import Message

SCENARIOS = {4: "arise_het_4", 8: str(Path(__file__).with_name("eight_rovers.yaml"))}
"""Scenario by the number of robots."""


@dataclass(frozen=True)
class Loop:
    """A closed loop around the plane.

    Attributes
    ----------
    name : str
        As figures and tables show it.
    changes : tuple of str
        Overrides ``a.b=value`` of the scenario.
    bandwidth : float or None
        Bandwidth of the disturbance observer that replaces the sum of the torque, rad/s.
    compensated : bool
        Whether the parent controller knows the heights of the masses and compensates their weight.
    """

    name: str
    changes: tuple[str, ...] = ()
    bandwidth: float | None = None
    compensated: bool = False

    def scenario(self, robots: int, duration: float, changes: tuple[str, ...] = ()) -> PlaneScenario:
        """Return the scenario for a number of robots and a duration (s), with further overrides."""
        overrides = [f"duration={duration}", *self.changes, *changes]
        return on_plane(find_scenario(SCENARIOS[robots], overrides), "the rig")


@dataclass(frozen=True)
class Deviation:
    """How a rig differs from what the swarm knows: by its setup, and by overrides of the plane's properties."""

    setup: Setup
    plane: tuple[str, ...] = ()


class Case(NamedTuple):
    """What is computed: a loop with a number of robots on a rig, by a seed, for a duration, s.

    Imperfection and value say which rig it is.
    """

    robots: int
    loop: Loop
    imperfection: str
    value: float
    deviation: Deviation
    seed: int
    duration: float

    @property
    def key(self) -> tuple[int, str, str, float, float, int]:
        """Which trial it is, as for `Outcome`."""
        return self.robots, self.loop.name, self.imperfection, self.value, self.duration, self.seed


class Outcome(NamedTuple):
    """A row of the tables.

    Attributes
    ----------
    robots, loop, imperfection, value, duration, seed : int, str, str, float, float, int
        Which trial it was.
    settled : bool
        Whether the error is at most `SETTLED` and all robots are on the plank.
    error : float
        Largest error of the angle in the last 2 s, rad; infinite if a robot left the plank, which ends the trial.
    farthest : float
        Largest distance of a robot from the axis, m.
    steepest : float
        Largest angle, rad.
    spread : float
        Least spread sqrt(S3)/S0 of the robots, m: the smaller, the worse conditioned is the swarm law.
    """

    robots: int
    loop: str
    imperfection: str
    value: float
    duration: float
    seed: int
    settled: bool
    error: float
    farthest: float
    steepest: float
    spread: float

    @classmethod
    def parsed(cls, row: Mapping[str, str]) -> Outcome:
        """Return the outcome of a row of a CSV file."""
        return cls(
            robots=int(row["robots"]),
            loop=row["loop"],
            imperfection=row["imperfection"],
            value=float(row["value"]),
            duration=float(row["duration"]),
            seed=int(row["seed"]),
            settled=row["settled"] == "True",
            error=float(row["error"]),
            farthest=float(row["farthest"]),
            steepest=float(row["steepest"]),
            spread=float(row["spread"]),
        )

    @property
    def cell(self) -> tuple[int, str, str, float, float]:
        """What it shares with trials by other seeds."""
        return self.robots, self.loop, self.imperfection, self.value, self.duration

    @property
    def key(self) -> tuple[int, str, str, float, float, int]:
        """Which trial it was."""
        return (*self.cell, self.seed)


def run(case: Case) -> Outcome:
    """Run a trial until its end, or until a robot leaves the plank."""
    loop, deviation = case.loop, case.deviation
    heights = [f"swarm.agents.{robot}.center_height={deviation.setup.height}" for robot in range(case.robots)]
    compensation = ("controller.height_compensation=true", *heights) if loop.compensated else ()
    scenario = loop.scenario(case.robots, case.duration, compensation)
    true = loop.scenario(case.robots, case.duration, deviation.plane)
    states = states_on(rig_of(true, deviation.setup, case.seed), scenario, loop.bandwidth)
    result = judged(scenario, states)
    error = inf if len(states) < scenario.steps else result.error
    return Outcome(
        case.robots,
        loop.name,
        case.imperfection,
        float(case.value),
        case.duration,
        case.seed,
        error <= SETTLED,
        error,
        result.farthest,
        result.steepest,
        min(spread(scenario, state) for state in states),
    )


def states_on(rig: MujocoRig, scenario: PlaneScenario, bandwidth: float | None = None) -> list[State]:
    """Return the states of a trial, whose last one is early if a robot has left the plank.

    With a bandwidth (rad/s), the torque is estimated from the plane's motion.
    """
    swarm = Swarm(scenario, rig) if bandwidth is None else WatchingSwarm(scenario, rig, bandwidth)
    edge = 0.5 * scenario.plane.length + OVERHANG
    states: list[State] = []
    while len(states) < scenario.steps:
        states.append(swarm.advance())
        if not all(abs(place) <= edge for place in states[-1].places):
            break
    return states


def spread(scenario: PlaneScenario, state: State) -> float:
    """Return sqrt(S3)/S0 of the robots in a state, m, by the masses that they know."""
    masses = [agent.mass for agent in scenario.agents]
    moments = second_moments(zip(masses, state.places, strict=True))
    return sqrt(moments.s3) / moments.s0


class WatchingSwarm(Swarm):
    """A swarm whose observer estimates the torque from the plane's motion, as ``observer.type: parent_response`` does.

    Parameters
    ----------
    scenario, rig
        As for `Swarm`.
    bandwidth : float
        Of the disturbance observer, rad/s.
    """

    def __init__(self, scenario: PlaneScenario, rig: MujocoRig, bandwidth: float) -> None:
        super().__init__(scenario, rig)
        plane = scenario.plane
        self._estimator = TorqueEstimator(plane.inertia, plane.friction, bandwidth, scenario.period)
        self._inertia = 0.0
        self._estimate = 0.0, 0.0

    def _send(self, messages: Iterable[Message], now: int) -> None:
        super()._send([self._estimated(message) for message in messages], now)

    def _estimated(self, message: Message) -> Message:
        """Take the motion of the plane, and return a message with the estimated torque if it has one."""
        if isinstance(message, PlaneState):
            self._estimate = self._estimator.update(message.angle, message.angular_velocity, self._inertia)
        elif isinstance(message, AbstractState):
            self._inertia = message.inertia
            torque, rate = self._estimate
            return message._replace(torque=torque, torque_rate=rate)
        return message
