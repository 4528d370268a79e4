"""Settings that the nodes of a run share, whatever their part in the swarm; this module needs no ROS."""

from __future__ import annotations

from dataclasses import dataclass

from swarmabs_config.graph import KEPT_STEPS
from swarmabs_core.declaration import part, same, setting
from swarmabs_core.realtime.base import Realtime, Schedule
from swarmabs_core.settings import Run
from swarmabs_ros.lockstep import FIRST


@dataclass(frozen=True, slots=True)
class LockstepSettings:
    """Settings of every node in lockstep."""

    period_ns: int = same(Run, "period_ns")
    last_step: int | None = same(Run, "last_step")
    stall_timeout: float = setting(
        5.0, "duration of a silence that is reported as a stall, {unit}; 0: never", unit="s", minimum=0.0
    )
    repeat_after: float = setting(
        FIRST, "shortest wait for an answer before the last messages are sent again", unit="s", above=0.0
    )
    repeat_steps: int = setting(
        KEPT_STEPS, "largest number of steps whose messages are sent again at once", minimum=1, maximum=KEPT_STEPS
    )
    match: tuple[str, ...] = setting(
        (), "endpoints to wait for before the start, each 'TOPIC NUMBER'; none: start at once"
    )


@dataclass(frozen=True, slots=True)
class Variant:
    """How the messages of a run in lockstep are passed on."""

    packed: bool = setting(
        default=False,
        description="whether robots receive the three broadcasts as one message, plane and recorder the robots' states",
    )
    steered: bool = setting(
        default=False, description="whether the run is steered: each step starts with the order for it"
    )


@dataclass(frozen=True, slots=True)
class RealtimeSettings:
    """Settings of every node in real time."""

    schedule: Schedule = part(Schedule, name="")
    await_epoch: bool = setting(
        default=False, description="whether the process that starts the node sends it the epoch"
    )
    clock_tolerance: float = same(Realtime, "clock_tolerance")
    autostart: bool = setting(default=True, description="whether to configure and activate the node at once")
    scheduling: str = setting(
        "other", "scheduling of the node's threads: other, or a real-time class", choices=("other", "fifo", "rr")
    )
    priority: int = setting(
        50,
        "priority within a real-time class of the thread that executes the steps; that of all others is one less",
        minimum=2,
        maximum=99,
    )
    lock_memory: bool = setting(default=False, description="whether to keep all memory from being paged out")


@dataclass(frozen=True, slots=True)
class RobotTopics:
    """Setting of robots, and of the nodes that read what robots publish."""

    own_topics: bool = setting(
        default=False, description="whether each robot publishes on topics below the name of its own node"
    )
