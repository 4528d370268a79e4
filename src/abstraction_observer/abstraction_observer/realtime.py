"""Node ``abstraction_observer`` in real time: it sums up the robots that are heard."""

from __future__ import annotations

import sys
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from abstraction_observer.memory import MemoryFile
from abstraction_observer.node import PARAMETERS as LOCKSTEP
from swarmabs_config.graph import OBSERVER
from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.base import OBSERVER_PHASE
from swarmabs_core.realtime.observer import FEWEST, RealtimeObserver, RealtimeObserverConfig
from swarmabs_core.realtime.plausibility import Bounds
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import choose, run_realtime, schedule_of

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings

PARAMETERS = (
    *choose(LOCKSTEP, "members", "gravity", "ksd"),
    Parameter("plane_length", 1.0, "length of the plane, m", above=0.0),
    Parameter(
        "swarm_mass",
        0.0,
        "mass of all robots that ever take part, kg, which bounds what a message may say; 0: unknown",
        minimum=0.0,
    ),
    Parameter("state_age_limit", 0.1, "age of a robot's state from which on it is taken to stand still, s", above=0.0),
    Parameter(
        "start",
        "wait",
        "how many robots must have been heard before the swarm moves: all, as many as quorum says, or two",
        choices=("wait", "quorum", "proceed"),
    ),
    Parameter("memory", "", "file that keeps where silent robots stand for a node that begins anew; empty: none"),
    Parameter("quorum", 0, "robots that must have been heard with start quorum", minimum=0, maximum=65535),
)


def needed(settings: Settings) -> int:
    """Return how many robots must have been heard before the swarm moves.

    Raises
    ------
    InputError
        If the quorum is none.
    """
    robots, start, quorum = len(settings.integers("members")), settings.text("start"), settings.integer("quorum")
    if start != "quorum":
        return robots if start == "wait" else FEWEST
    if not FEWEST <= quorum <= robots:
        raise InputError(f"parameter quorum: {quorum} of {robots} robots; give a number from {FEWEST} to {robots}")
    return quorum


def config(settings: Settings) -> RealtimeObserverConfig:
    """Return the behaviour's configuration.

    Raises
    ------
    InputError
        If parameters contradict each other.
    """
    mass = settings.number("swarm_mass") or inf
    clock = schedule_of(settings)
    return RealtimeObserverConfig(
        members=settings.integers("members"),
        schedule=clock,
        bounds=Bounds(settings.number("gravity"), settings.number("plane_length"), mass, clock.period_ns / 1e9),
        ksd=settings.number("ksd"),
        needed=needed(settings),
        state_age_limit=settings.number("state_age_limit"),
        clock_tolerance=settings.number("clock_tolerance"),
    )


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    """Return the behaviour."""
    path = settings.text("memory")
    memory = MemoryFile(Path(path), node.notes.warning) if path else None
    return RealtimeSpec(RealtimeObserver(config(settings), memory), OBSERVER_PHASE)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_realtime(OBSERVER, PARAMETERS, make, args)


if __name__ == "__main__":
    sys.exit(main())
