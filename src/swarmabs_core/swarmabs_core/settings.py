"""Settings of a run that several nodes share, whatever the parent system."""

from __future__ import annotations

from dataclasses import dataclass

from swarmabs_core.declaration import setting
from swarmabs_core.membership import Change, ChangeKind


@dataclass(frozen=True, slots=True)
class Run:
    """Settings of a run that nodes share; each node declares those that it needs."""

    period_ns: int = setting(10_000_000, "control period", unit="ns", minimum=1)
    last_step: int | None = setting(None, "last step of the run", unset=-1)
    members: tuple[int, ...] = setting((1, 2, 3, 4), "ids of all robots that ever take part", minimum=1, maximum=65535)
    schedule: tuple[Change, ...] = setting(
        (), "scheduled changes of the membership, each 'KIND AGENT STEP', such as 'kill 3 500'", make=Change.parse
    )
    division: int = setting(
        0,
        "number of steps from a change of the membership on in which the observer tells how the abstract state divides",
        minimum=0,
    )
    seed: int = setting(1, "seed of random faults and noise during the run", minimum=0, below=2**63)
    actuator_lag: float = setting(
        0.0, "time constant with which velocity or force follows the command, {unit}; 0: no lag", unit="s", minimum=0.0
    )


@dataclass(frozen=True, slots=True)
class Lockstep:
    """Reaction to a robot that does not answer."""

    on_stall: str = setting(
        "fail",
        "fail: the run fails; drop: the robot is dropped as if it had been killed",
        choices=("fail", "drop"),
    )
    stall_timeout: float = setting(
        5.0, "wall time without an answer after which a robot has stalled", unit="s", above=0.0
    )


@dataclass(frozen=True, slots=True)
class LifeSpan:
    """The steps in which a robot takes part, and its planned end, if any."""

    first_step: int = setting(0, "step at which the robot joins", minimum=0)
    end: ChangeKind | None = setting(
        None,
        "planned end of the robot",
        choices=("none", *(kind.value for kind in ChangeKind if kind is not ChangeKind.JOIN)),
        unset="none",
        make=ChangeKind,
        say=lambda kind: kind.value,
    )
    end_step: int | None = setting(None, "step of the planned end", unset=-1)
