"""What a recorder has of a virtual fleet."""

from collections.abc import Callable, Iterable
from functools import cache
from operator import methodcaller
from random import Random
from typing import NamedTuple

from tests.swarmabs_core.helpers import builtin
from tests.virtual.fleet import EPOCH, Network, VirtualFleet

from swarmabs_bag.run.figures import RealtimeFigures
from swarmabs_bag.run.realtime_gatherer import RealtimeCollector
from swarmabs_config import configure as lockstep, realtime as configure
from swarmabs_config.graph import CONTROLLER, OBSERVER, PLANE
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import decode
from swarmabs_core.messages import Message, Mode, Topic
from swarmabs_core.record import Record

LATENCY = 400_000
"""Time, ns, that a message takes to the recorder."""


class Stored(NamedTuple):
    """A message of a bag: topic, log time in ns, bytes."""

    topic: Topic
    time: int
    payload: bytes

    @property
    def message(self) -> Message:
        return decode(self.topic.message, self.payload)


class Recorded(NamedTuple):
    """What a recorder has at the end."""

    scenario: Scenario
    bag: tuple[Stored, ...]
    collector: RealtimeCollector
    figures: RealtimeFigures


def record(fleet: VirtualFleet, scenario: Scenario, *, loss: float = 0.0, jitter: float = 0.0) -> Recorded:
    """Record what a fleet has published; on the way, messages are lost (probability) and late (s)."""
    clock = configure.schedule(scenario, EPOCH)
    collector = RealtimeCollector(lockstep.members(scenario), clock, each_robot=scenario.decentralised)
    figures = RealtimeFigures(lockstep.parent_controller(scenario).reference, clock)
    draw = Random("recorder")
    arrived = [
        (EPOCH + time + LATENCY + round(draw.random() * jitter * 1e9), message)
        for time, _, message in fleet.published
        if draw.random() >= loss
    ]
    bag = []
    for time, message in sorted(arrived, key=lambda timed: timed[0]):
        for kept in collector.add(Record.of(message), time):
            figures.add(kept)
            bag.append(Stored(kept.topic, time, kept.payload))
    return Recorded(scenario, tuple(bag), collector, figures)


def deaths(fleet: VirtualFleet) -> None:
    for name in ("agent_002", OBSERVER, PLANE, CONTROLLER):
        fleet.run(0.6)
        fleet.kill(name)
        fleet.run(0.4)
        fleet.revive(name)
    fleet.run(0.6)


def operator(fleet: VirtualFleet) -> None:
    fleet.run(0.7)
    fleet.call(CONTROLLER, "stop")
    fleet.run(0.5)
    fleet.call(CONTROLLER, "reset")
    fleet.run(1.5)
    fleet.call("agent_003", "leave")
    fleet.run(0.4)
    fleet.call("agent_003", "join")
    fleet.run(0.7)


def clocks(fleet: VirtualFleet) -> None:
    for name in ("agent_001", OBSERVER, PLANE, CONTROLLER):
        for offset in (0.004, 0.3, -0.3, 0.0):
            fleet.run(0.25)
            fleet.set_clock(name, offset)
    fleet.run(1.0)


quiet, brief = methodcaller("run", 2.0), methodcaller("run", 0.5)
BAD = Network(jitter=0.012, loss=0.1, duplication=0.1, fading=0.02)
WORLDS: dict[str, tuple[tuple[str, ...], Network, Callable[[VirtualFleet], None], Mode]] = {
    "quiet": (("pd_het_4",), Network(), quiet, Mode.RUN),
    "brief": (("pd_het_4",), Network(), brief, Mode.RUN),
    "brief on a bad network": (("pd_het_4",), BAD, brief, Mode.RUN),
    "adaptive": (("arise_het_4",), Network(), quiet, Mode.RUN),
    "bad network": (("pd_het_4",), BAD, quiet, Mode.RUN),
    "deaths": (("pd_het_4",), Network(), deaths, Mode.RUN),
    "deaths on a bad network": (("arise_het_4",), BAD, deaths, Mode.RUN),
    "operator": (("pd_het_4",), Network(), operator, Mode.RUN),
    "operator on a bad network": (("pd_het_4",), BAD, operator, Mode.RUN),
    "begun in a stop": (("pd_het_4",), Network(), operator, Mode.STOP),
    "clocks": (("pd_het_4",), Network(), clocks, Mode.RUN),
    "limits": (("pd_het_4", "limits={velocity: 0.05, force: 0.1}"), Network(loss=0.05), quiet, Mode.RUN),
    "noisy plane": (("pd_het_4", "plane.sensor={noise: [1.0e-4, 1.0e-3]}"), Network(loss=0.05), quiet, Mode.RUN),
    "end stop": (
        ("pd_het_4", "plane.angle=0.05", "plane.angular_velocity=4", "plane.end_stop=0.06"),
        Network(),
        quiet,
        Mode.RUN,
    ),
}


@cache
def _lived(name: str) -> tuple[VirtualFleet, Scenario]:
    named, network, story, mode = WORLDS[name]
    scenario = builtin(*named)
    fleet = VirtualFleet(scenario, network=network, start_mode=mode)
    story(fleet)
    return fleet, scenario


@cache
def world(name: str, *, loss: float = 0.0, jitter: float = 0.0) -> Recorded:
    return record(*_lived(name), loss=loss, jitter=jitter)


def messages(bag: Iterable[Stored]) -> list[Message]:
    return [stored.message for stored in bag]
