"""What is different about a bag of a run in real time: its clock, its gaps, and the time of the controller's law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_bag.attached import REALTIME, attached_provenance
from swarmabs_bag.realtime_recording import RECORDED, RealtimeFigures
from swarmabs_config import configure
from swarmabs_core.errors import InputError
from swarmabs_core.messages import BASIS, Basis, Source
from swarmabs_core.realtime.base import Schedule

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario

DRIVER = REALTIME
_WORLD = ("period_ns", "epoch_ns", "simulated_robots", "simulated_plane", "own_limits")


@dataclass(frozen=True, slots=True)
class RealtimeWorld:
    """How time became steps, which robots' bodies were simulated, whether the plane was, who had limits of its own."""

    schedule: Schedule
    robots: tuple[int, ...]
    plane: bool
    own_limits: tuple[int, ...] = ()

    def provenance(self) -> dict[str, object]:
        """Return it as it stands in the provenance."""
        lists = sorted(self.robots), sorted(self.own_limits)
        values = (self.schedule.period_ns, self.schedule.epoch_ns, lists[0], self.plane, lists[1])
        return dict(zip(_WORLD, values, strict=True))


def is_realtime(bag: BagReader) -> bool:
    """Tell whether a bag says that it was recorded in real time."""
    return bool(attached_provenance(bag).get("driver") == DRIVER)


def realtime_world(bag: BagReader) -> RealtimeWorld:
    """Return what a bag that was recorded in real time says of its world.

    Raises
    ------
    InputError
        If it does not say it.
    """
    found = attached_provenance(bag).get("realtime")
    said: Mapping[str, Any] = found if isinstance(found, dict) else {}
    period, epoch, robots, plane, limited = (said.get(name) for name in _WORLD)
    if (
        isinstance(robots, list)
        and isinstance(limited, list)
        and isinstance(plane, bool)
        and all(type(number) is int and number >= 0 for number in (period, epoch, *robots, *limited))
        and period
    ):
        return RealtimeWorld(Schedule(int(period), int(epoch or 0)), tuple(robots), plane, tuple(limited))
    raise InputError(
        f"{bag.path}: its provenance does not say how time became steps (realtime: {', '.join(_WORLD)}), so it cannot "
        "be verified"
    )


def law_begins(bag: BagReader) -> dict[int, int]:
    """Return for every step that the parent controller has answered the step with which its law's time had begun."""
    return {
        message.step: message.begun
        for _, _, message in bag.decoded((BASIS,))
        if isinstance(message, Basis) and message.source == Source.CONTROLLER
    }


def realtime_figures(bag: BagReader, scenario: Scenario) -> RealtimeFigures:
    """Return the figures of a bag, by the same arithmetic as while it was recorded.

    Raises
    ------
    DamagedBagError
        Where the bag is damaged.
    """
    figures = RealtimeFigures(configure.parent_controller(scenario).reference, Schedule(scenario.step_ns))
    for record in bag.records(RECORDED):
        figures.add(record)
    return figures
