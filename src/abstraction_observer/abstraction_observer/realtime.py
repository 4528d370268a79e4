"""Node ``abstraction_observer`` in real time: it sums up the robots' newest states."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from abstraction_observer.memory import MemoryFile
from swarmabs_config.graph import OBSERVER, RELEASE
from swarmabs_core.declaration import setting
from swarmabs_core.realtime.base import OBSERVER_PHASE
from swarmabs_core.realtime.observer import RealtimeObserver, RealtimeObserverConfig
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec
from swarmabs_ros.realtime_runner import RealtimeProgram
from swarmabs_ros.settings import RobotTopics

if TYPE_CHECKING:
    from swarmabs_ros.runner import Settings


@dataclass(frozen=True, slots=True)
class Memory:
    """Where the observer stores what it must know after a restart."""

    memory: str = setting("", "file that stores the positions of silent robots across restarts; empty: none")


PARAMETERS = (RealtimeObserverConfig, Memory, RobotTopics)
GAINS = ("ksd",)


def make(settings: Settings, node: RealtimeNode) -> RealtimeSpec:
    """Return the behaviour."""
    path = settings.declared(Memory).memory
    memory = MemoryFile(Path(path), node.notes.warning) if path else None
    config = settings.declared(RealtimeObserverConfig)
    observer = RealtimeObserver(config, memory)
    return RealtimeSpec(
        observer,
        OBSERVER_PHASE,
        services={} if config.pair.single else {RELEASE: observer.voice.release},
        settled=lambda: observer.voice.settled,
        tune=lambda changed: observer.tuned(changed.declared(RealtimeObserverConfig)),
    )


main = RealtimeProgram(OBSERVER, PARAMETERS, make, GAINS)


if __name__ == "__main__":
    sys.exit(main())
