"""Seeded trials of a fleet without observer and controller: faults of up to three of eight robots; what its bag says.

Usage: python -m tests.hosts.peer_trials FOLDER [--trials N] [--seconds S] [--seed SEED] [--robots N]

That is for people, as root. Of what holds during the trials only the bag tells, never the time that this process took.
"""

import argparse
import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import NamedTuple

from tests.hosts.cluster import Host, Hosts, hosts
from tests.hosts.fleet_hosts import CALM, FleetOnHosts, Operator
from tests.hosts.namespaces import say
from tests.hosts.switch import DIRECTIONS, Impairment
from tests.hosts.trials import impaired, killed, paused, prefer, without_power

from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import realtime_world
from swarmabs_core.messages import AGENT_STATE, PLANE_STATE, AgentState, PlaneState, Status
from swarmabs_core.nodes import agent_name

ROBOTS = 8
_NAME = "peers"
FAULTS = ("kill", "pause", "power", "cut", "delay")


class Fault(NamedTuple):
    """What happens to the host of a robot; `delay` (s) is that of what it sends and receives."""

    kind: str
    robot: int
    delay: float = 0.0
    directions: tuple[str, ...] = DIRECTIONS


class Trial(NamedTuple):
    """Faults at the same time, for a time (s), while all hosts lose a share of what is sent to them."""

    faults: tuple[Fault, ...]
    seconds: float
    loss: float


def drawn(seed: str, number: int, robots: int = ROBOTS) -> Trial:
    """Return a trial, in which a majority stays whole; one in ten is without a fault, for comparison."""
    draw = Random(f"peers {seed} {number}")
    seconds, loss = draw.choice((draw.uniform(0.02, 0.3), draw.uniform(0.3, 3.0))), draw.choice((0.0, 0.2, 0.5))
    harmed = draw.sample(range(1, robots + 1), draw.randint(1, (robots - 1) // 2))
    if number % 10 == 9:
        return Trial((), seconds, loss)
    faults = []
    for robot in harmed:
        kind = draw.choice(FAULTS)
        one_way = draw.choice((DIRECTIONS, *((each,) for each in DIRECTIONS)))
        delay = draw.uniform(0.01, 0.3) if kind == "delay" else 0.0
        faults.append(Fault(kind, robot, delay, one_way if kind == "cut" else DIRECTIONS))
    return Trial(tuple(faults), seconds, loss)


class Peers(FleetOnHosts):
    """Robots that sum up the swarm by themselves, and a base with a simulated plane and the recorder."""

    def __init__(self, machines: list[Host], folder: Path) -> None:
        super().__init__(machines, folder, name=_NAME, quorum=len(machines) - 1, recorder=True, peers=True)


@dataclass(slots=True)
class Trials:
    """Does trials to a running fleet."""

    machines: Hosts
    fleet: Peers
    operator: Operator
    seed: str
    tell: Callable[[str], None] = lambda _: None

    def run(self, number: int) -> tuple[Trial, int, int]:
        """Do a trial, and wait until all robots follow again; return when it began and ended, ns since 1970."""
        trial = drawn(self.seed, number, len(self.fleet.ids))
        self.tell(f"{number}: {trial}")
        prefer(self.machines, self.fleet)
        begin = time.time_ns()
        with ExitStack() as stack:
            for station in self.fleet.stations:
                stack.enter_context(impaired(station.host, Impairment(loss=trial.loss), ("to",)))
            for fault in trial.faults:
                stack.enter_context(self._fault(fault))
            # How long it lasts is part of what happens.
            time.sleep(trial.seconds)
        end = time.time_ns()
        self.operator.until_following(*self.fleet.ids)
        self.operator.until_counted(*self.fleet.ids)
        self.operator.until_calm()
        return trial, begin, end

    def _fault(self, fault: Fault) -> AbstractContextManager[None]:
        station, node = self.fleet.robots[fault.robot], agent_name(fault.robot)
        if fault.kind == "kill":
            return killed(station, node, f"swarmabs-{_NAME}-{node}.service")
        if fault.kind == "pause":
            return paused(station, node)
        if fault.kind == "power":
            return without_power(station)
        how = Impairment(fault.delay, loss=float(fault.kind == "cut"))
        return impaired(station.host, how, fault.directions)


class Recorded:
    """What the bags of a fleet say of trials."""

    def __init__(self, fleet: Peers) -> None:
        self._stopped: dict[int, list[int]] = {}
        self._angles: dict[int, float] = {}
        for bag in fleet.bags(fleet.base):
            reader = open_bag(bag)
            self._schedule = realtime_world(reader).schedule
            for _, _, message in reader.decoded({AGENT_STATE, PLANE_STATE}):
                if isinstance(message, PlaneState):
                    self._angles[message.step] = abs(message.angle)
                elif isinstance(message, AgentState) and message.status == Status.SAFE_STOP:
                    self._stopped.setdefault(message.step, []).append(message.agent_id)

    def problems(self, trial: Trial, begin: int, end: int) -> list[str]:
        """Return what went wrong in a trial: unharmed robots that stopped, and how far the plane moved."""
        harmed = {fault.robot for fault in trial.faults}
        steps = range(*map(self._schedule.step, (begin, end)))
        stopped = sorted({robot for step in steps for robot in self._stopped.get(step, ())} - harmed)
        angle = max((self._angles[step] for step in steps if step in self._angles), default=0.0)
        found = [f"robots {stopped} stopped"] if stopped else []
        return found + ([f"the angle reached {angle:.3g} rad"] if angle > CALM else [])


@contextmanager
def running(
    folder: Path, seed: str, robots: int = ROBOTS, tell: Callable[[str], None] = lambda _: None
) -> Iterator[Trials]:
    """Have a fleet that has levelled its plane; afterwards it is stopped, and its bag is complete."""
    with hosts(robots + 1, seed=seed) as machines:
        fleet = Peers(list(machines), folder)
        fleet.install()
        fleet.start()
        with fleet.operator() as operator:
            operator.reset_until_calm(*fleet.ids, service=f"{agent_name(1)}/reset")
            yield Trials(machines, fleet, operator, seed, tell)
        for process in [station.start("systemctl", "stop", "--", fleet.target) for station in fleet.stations]:
            process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.hosts.peer_trials", description="Trials of robots alone")
    parser.add_argument("folder", type=Path, help="folder of the fleet and its bags; new")
    parser.add_argument("--trials", type=int, default=100, help="number of trials")
    parser.add_argument("--robots", type=int, default=ROBOTS, help="number of robots")
    parser.add_argument("--seconds", type=float, default=math.inf, help="time after which no trial is begun, s")
    parser.add_argument("--seed", default="1", help="of all that happens")
    options = parser.parse_args()
    until_ = time.monotonic() + options.seconds
    with running(options.folder, options.seed, options.robots, say) as trials:
        numbers = (number for number in range(options.trials) if time.monotonic() < until_)
        done = {number: trials.run(number) for number in numbers}
    recorded = Recorded(trials.fleet)
    for number, each in done.items():
        say(f"{number} {each[0]}: {'; '.join(recorded.problems(*each)) or 'ok'}")


if __name__ == "__main__":
    main()
