"""A seeded storm over a fleet: power cuts, crashes, partitions, bad networks; and what must hold when it is over.

Usage: python -m tests.hosts.storm [--robots N] [--rounds N] [--seed SEED] [--stay]

That is for people, as root: a fleet on hosts of this machine is deployed, installed and started, and then the storm
passes over it. With --stay the fleet goes on until Ctrl-C, and lines say how to look at it and to touch it.
"""

import argparse
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from tests.hosts.black_box import Note
from tests.hosts.cluster import Hosts, hosts
from tests.hosts.fleet_hosts import CALM, CALM_FOR, PATIENCE, PERIOD, FleetOnHosts
from tests.hosts.namespaces import say
from tests.hosts.switch import PERFECT, Impairment
from tests.processes import until

AGE = 0.1
"""realtime.broadcast_age_limit, s."""
BOUND = round((AGE + 2.0 * PERIOD) * 1e9)
"""Time, ns, after the last broadcast by which every robot has commanded its stop (docs/explanation/safety.md)."""
_FALLEN = 1.0
"""Angle, rad, from which on somebody has to lift the plane."""


def stands(note: Note) -> bool:
    """Tell whether a robot does what it has to in a safe stop: no velocity, or a force against its velocity."""
    return note.command == 0.0 or note.command * note.velocity < 0.0


@dataclass(slots=True)
class Storm:
    """Disturbs a running fleet in rounds, as a seed says, and tells what happens; the first machine is the base."""

    machines: Hosts
    fleet: FleetOnHosts
    seed: str
    tell: Callable[[str], None] = lambda _: None
    _cut_off: list[tuple[int, int, int]] = field(default_factory=list)
    _since: dict[int, int] = field(default_factory=dict)
    _together: set[int] = field(default_factory=set)

    def round(self, number: int) -> None:
        """Let some things happen, mend everything, and wait until the swarm is in order again."""
        draw = Random(f"{self.seed} {number}")
        self._together = set(self.fleet.ids)
        for _ in range(draw.randint(3, 6)):
            self._disturb(draw)
            # How long things last is part of what happens.
            time.sleep(draw.uniform(0.1, 3.0))
        self._mend(draw)
        self.settle()
        self.check()

    def settle(self) -> None:
        """Let the swarm move, and wait until all robots follow and the plane is level."""
        base = self.fleet.base
        base.until_active(self.fleet.target)
        with self.fleet.operator() as operator:
            operator.reset()

            def in_order() -> bool:
                if abs(operator.calm(CALM)[1]) > _FALLEN:
                    self.tell("somebody lifts the plane")
                    base.run("systemctl", "restart", f"swarmabs-{self.fleet.name}-plane_sim.service")
                    operator.reset()
                return operator.calm(CALM)[0] >= CALM_FOR and all(map(operator.follows, self.fleet.ids))

            until(in_order, lambda: f"order; {operator.look()['newest']}", 3.0 * PATIENCE)
        self.tell("all robots follow, and the plane is level")

    def check(self) -> None:
        """Prove what must hold at all times: limits, lanes, and nobody moved while he could not hear the base."""
        self.fleet.check_bodies()
        for number, begin, end in self._cut_off:
            moving = [note for note in self.fleet.notes(number) if begin + BOUND < note.now < end and not stands(note)]
            assert not moving, (number, begin, end, moving[:3])

    def _disturb(self, draw: Random) -> None:
        action = draw.choice((self._cut_power, self._crash, self._crash, self._partition, self._partition, self._spoil))
        before = time.time_ns()
        action(draw)
        self._note_who_is_cut_off(before, time.time_ns())

    def _cut_power(self, draw: Random) -> None:
        station = draw.choice(self.fleet.stations)
        if not station.host.alive:
            self.tell(f"{station.name} gets its power back")
            station.power_on()
        else:
            self.tell(f"{station.name} loses its power")
            station.host.kill()

    def _crash(self, draw: Random) -> None:
        station = draw.choice(self.fleet.stations)
        units = (station.etc / "swarmabs" / self.fleet.name / "units.txt").read_text().split()
        unit = draw.choice([unit for unit in units if unit.endswith(".service")])
        if station.host.alive:
            self.tell(f"{unit} crashes on {station.name}")
            station.run("systemctl", "kill", unit)

    def _partition(self, draw: Random) -> None:
        if draw.random() < 0.3:
            self.tell("the network is whole")
            self._together = set(self.fleet.ids)
            self.machines.partition()
            return
        numbers = list(range(len(self.fleet.stations)))
        draw.shuffle(numbers)
        here = numbers[: draw.randint(1, len(numbers) - 1)]
        there = [number for number in numbers if number not in here]
        with_base = here if 0 in here else there
        self._together = {self.fleet.ids[number - 1] for number in with_base if number}
        self.tell(f"the network falls apart: {here} {there}")
        self.machines.partition(here, there)

    def _spoil(self, draw: Random) -> None:
        delay = draw.uniform(0.001, 0.03)
        how = Impairment(delay, draw.uniform(0.0, delay), draw.uniform(0.0, 0.2), draw.uniform(0.0, 0.1))
        self.tell(f"the network is bad: {how}")
        self.machines.impair(how)

    def _note_who_is_cut_off(self, before: int, after: int) -> None:
        """Note whom the base certainly did not reach, from times (ns) before and after what has happened."""
        for number in self.fleet.ids:
            reached = self.fleet.base.host.alive and number in self._together
            if not reached:
                self._since.setdefault(number, after)
            elif number in self._since:
                self._cut_off.append((number, self._since.pop(number), before))

    def _mend(self, draw: Random) -> None:
        self.tell("all is mended, but for a network that is as networks are")
        before = time.time_ns()
        self._cut_off += [(number, begin, before) for number, begin in self._since.items()]
        self._since.clear()
        self.machines.partition()
        self.machines.impair(draw.choice((PERFECT, Impairment(0.015, 0.005, 0.02))))
        for station in self.fleet.stations:
            if not station.host.alive:
                station.power_on()


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.hosts.storm", description="A storm over a fleet on hosts")
    parser.add_argument("--robots", type=int, default=4, help="robots, each on a host of its own (2 to 20)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of the storm; 0: none")
    parser.add_argument("--seed", default="1", help="of all that happens")
    parser.add_argument("--stay", action="store_true", help="let the fleet go on until Ctrl-C")
    options = parser.parse_args()
    with (
        suppress(KeyboardInterrupt),
        TemporaryDirectory(prefix="swarmabs-hosts-") as folder,
        hosts(1 + options.robots, seed=options.seed) as machines,
    ):
        fleet = FleetOnHosts(machines, Path(folder) / "fleet", quorum=max(2, options.robots - 1))
        fleet.install()
        fleet.start()
        storm = Storm(machines, fleet, options.seed, say)
        storm.settle()
        for number in range(options.rounds):
            storm.round(number)
            say(f"round {number + 1}: no robot has left its lane or its limits, or moved on old data")
        if options.stay:
            base = f"nsenter --target={machines[0].pid} --net --mount --uts --ipc --pid env HOME=/run TMPDIR=/run"
            say(f"On the base, from another terminal, as root:\n  {base} {fleet.checkout.swarm} status {fleet.file}")
            for station in fleet.stations:
                host = station.host
                say(f"{station.name}: process {host.pid}, {host.address}, logs in {station.etc / 'log'}")
            signal.pause()


if __name__ == "__main__":
    main()
