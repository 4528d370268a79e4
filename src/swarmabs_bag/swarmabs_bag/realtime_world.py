"""What a bag in real time says of its run: the mapping from time to steps, what was simulated, and its figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_bag.attached import attached_provenance
from swarmabs_bag.run.figures import RealtimeFigures
from swarmabs_bag.run.realtime_gatherer import RECORDED
from swarmabs_config import configure
from swarmabs_config.graph import STANDBY_TOPICS
from swarmabs_core.errors import InputError
from swarmabs_core.messages import BASIS, Basis, Relay, Source, relay_topic
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.relayed import law_time

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario

_WORLD = ("period_ns", "epoch_ns", "simulated_robots", "simulated_plane", "own_limits")


@dataclass(frozen=True, slots=True)
class RealtimeWorld:
    """Mapping from time to steps, simulated robots, whether the plane was simulated, and robots with other limits."""

    schedule: Schedule
    robots: tuple[int, ...]
    plane: bool
    own_limits: tuple[int, ...] = ()

    def provenance(self) -> dict[str, object]:
        """Return the entry for the provenance."""
        lists = sorted(self.robots), sorted(self.own_limits)
        values = (self.schedule.period_ns, self.schedule.epoch_ns, lists[0], self.plane, lists[1])
        return dict(zip(_WORLD, values, strict=True))


def realtime_world(bag: BagReader) -> RealtimeWorld:
    """Return the recorded world of a bag in real time; raise `InputError` if it is missing."""
    entry = attached_provenance(bag).get("realtime")
    said: Mapping[str, Any] = entry if isinstance(entry, dict) else {}
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
        f"{bag.path}: its provenance lacks a valid entry realtime ({', '.join(_WORLD)}), so it cannot be verified; "
        "use a bag written by the recorder"
    )


def law_begins(bag: BagReader) -> dict[int, int]:
    """Return, for every step answered by a parent controller, the step at which the time of its law began."""
    begins: dict[int, int] = {}
    relays = (topic for topic in bag.topics() if topic.message is Relay)
    for _, _, message in bag.decoded((BASIS, STANDBY_TOPICS[BASIS], *relays)):
        if isinstance(message, Relay):
            step, begun = law_time(message)
            begins.setdefault(step, begun)
        elif isinstance(message, Basis) and message.source == Source.CONTROLLER:
            begins[message.step] = message.begun
    return begins


def realtime_figures(bag: BagReader, scenario: Scenario) -> RealtimeFigures:
    """Return the figures of a bag, by the same arithmetic as during the recording.

    Raises `DamagedBagError` if the bag is damaged.
    """
    figures = RealtimeFigures(configure.law_reference(scenario), Schedule(scenario.step_ns))
    for record in bag.records((*RECORDED, *map(relay_topic, configure.relaying(scenario)))):
        figures.add(record)
    return figures
