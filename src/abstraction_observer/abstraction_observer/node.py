"""Node ``abstraction_observer``: states of the robots in, abstract and auxiliary state of the swarm out."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_config.graph import OBSERVER
from swarmabs_core import model
from swarmabs_core.behaviours import Observer, Steered
from swarmabs_core.declaration import same
from swarmabs_core.membership import SILENT
from swarmabs_core.messages import Messages
from swarmabs_core.models import ObserverConfig, SystemObserverConfig
from swarmabs_core.settings import Lockstep
from swarmabs_ros.lockstep import NodeSpec
from swarmabs_ros.parameters import BySystem
from swarmabs_ros.runner import LockstepProgram, Settings
from swarmabs_ros.settings import Variant
from swarmabs_ros.status import StatusChannel

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_core.messages import Topic

    HearAll = Callable[[Topic, list[bytes]], Messages]

CONFIG: BySystem[model.ObserverConfig] = BySystem(ObserverConfig, SystemObserverConfig)


@dataclass(frozen=True, slots=True)
class StallReaction:
    """Reaction to robots that do not answer."""

    on_stall: str = same(Lockstep, "on_stall")


PARAMETERS = (CONFIG, StallReaction, Variant)


def make(settings: Settings, status: StatusChannel) -> NodeSpec:  # noqa: ARG001 - this node has nothing to report
    """Return the behaviour and its reaction to a stall."""
    variant = settings.declared(Variant)
    observer, hear_all = _observer(settings.chosen(CONFIG), packed=variant.packed)
    gate = Steered(observer) if variant.steered else None

    def drop() -> Messages:
        if gate is not None and not gate.open:  # the node waits for an order, not for robots
            return ()
        silent = observer.silent_agents()
        return observer.drop(silent, SILENT) if silent else ()

    on_stall = drop if settings.declared(StallReaction).on_stall == "drop" else None
    return NodeSpec(gate or observer, on_stall=on_stall, hear_all=None if gate else hear_all)


def _observer(config: model.ObserverConfig, *, packed: bool) -> tuple[Observer, HearAll | None]:
    """Return the behaviour, and what takes its serialized messages, if it does so itself."""
    if not packed:
        return Observer(config), None
    from swarmabs_core.behaviours.packed import PackedObserver  # noqa: PLC0415 - only packed runs need numpy

    observer = PackedObserver(config)
    return observer, observer.hear_all


main = LockstepProgram(OBSERVER, PARAMETERS, make)


if __name__ == "__main__":
    sys.exit(main())
