"""Seeded trials of standby coordinators: one fault at a time in a running fleet; then what its bags say of each.

Usage: python -m tests.hosts.trials FOLDER [--trials N] [--first N] [--seconds S] [--seed SEED]

That is for people, as root. Of what holds during the trials only the bags tell, never the time that this process took.
"""

import argparse
import json
import math
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import psutil
from tests.hosts.cluster import Host, Hosts, hosts
from tests.hosts.fleet_hosts import CALM, PATIENCE, FleetOnHosts, Operator
from tests.hosts.namespaces import say
from tests.hosts.stations import Station
from tests.hosts.switch import DIRECTIONS, PERFECT, Impairment
from tests.processes import until

from swarmabs_analysis.verification.realtime_nodes import NO_STATE_BEFORE
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import realtime_world
from swarmabs_config.graph import CONTROLLER, OBSERVER, RECORDER, STANDBY_TOPICS, standby_name
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    DESIRED_ABSTRACT_STATE,
    EVENTS,
    PLANE_STATE,
    AgentState,
    EventKind,
    Message,
    PlaneState,
    Status,
    SwarmEvent,
    Topic,
)

LONGEST_STOP = 0.2
"""Time, s, that a fault may stop a robot; the angle that it may cost is `CALM`."""
ROBOTS = 8
_LED_FOR = 0.5
"""Time, s, at the end of a trial in which one of each pair must have led alone."""
_LIGHT = "health_client"
_NAME = "pair"
_NAMED = "__node:="
_DONE = "trials.txt"
"""Seed, number, begin and end of each trial that was done."""


class Trial(NamedTuple):
    """A fault of a node or a host, for a time (s); `delay` (s) is that of what the host sends and receives."""

    fault: str
    of: str
    seconds: float
    delay: float = 0.0
    directions: tuple[str, ...] = DIRECTIONS


NODES = tuple(name(node) for node in (OBSERVER, CONTROLLER, RECORDER) for name in (str, standby_name))
PLACES = ("base", "spare")


def drawn(seed: str, number: int) -> Trial:
    """Return a trial; one in ten is without a fault, for comparison."""
    draw = Random(f"{seed} {number}")
    seconds = draw.choice((draw.uniform(0.02, 0.3), draw.uniform(0.3, 3.0)))
    fault = draw.choice(("kill", "kill", "pause", "pause", "pause", "power", "cut", "cut", "delay", "delay"))
    if number % 10 == 9:
        return Trial("nothing", "nobody", seconds)
    if fault in {"kill", "pause"}:
        return Trial(fault, draw.choice(NODES), seconds)
    directions = (
        draw.choice((DIRECTIONS, DIRECTIONS, *((each,) for each in DIRECTIONS))) if fault == "cut" else DIRECTIONS
    )
    return Trial(fault, draw.choice(PLACES), seconds, draw.uniform(0.01, 0.3) if fault == "delay" else 0.0, directions)


class PairedFleet(FleetOnHosts):
    """Eight robots, a simulated plane on the host of the first, and coordinators with standbys on two more hosts.

    All bodies are simulated as the law expects, so `verify` computes everything that is recorded anew.
    """

    def __init__(self, machines: Sequence[Host], folder: Path) -> None:
        places = {number: (-1) ** number * (0.03 + 0.02 * number) for number in range(1, ROBOTS + 1)}
        super().__init__(
            machines,
            folder,
            name=_NAME,
            quorum=ROBOTS,
            recorder=True,
            standby=True,
            plane="{host: robot-1}",
            drives={number: f"{{type: simulated, position: {place:.3g}}}" for number, place in places.items()},
            limited=False,
        )
        self.places = dict(zip(PLACES, (self.base, self.spare), strict=True))

    def place_of(self, node: str) -> Station:
        return self.places["spare" if node.endswith(standby_name("")) else "base"]

    def unit(self, node: str) -> str:
        return f"swarmabs-{self.name}-{node}.service"


HOSTS = len(PLACES) + ROBOTS


@dataclass(slots=True)
class Trials:
    """Does trials to a running fleet."""

    machines: Hosts
    fleet: PairedFleet
    seed: str
    tell: Callable[[str], None] = lambda _: None
    _operators: dict[str, tuple[Operator, ExitStack]] = field(default_factory=dict)

    def calm(self) -> None:
        """Let the swarm move until the plane is level, and all pairs are whole."""
        with self.fleet.operator() as operator:
            operator.reset_until_calm(*self.fleet.ids)
        self._until_whole("base")

    def run(self, number: int) -> tuple[int, int]:
        """Do a trial, and wait until all is whole again; return when it began and ended, ns since 1970."""
        trial = drawn(self.seed, number)
        prefer(self.machines, self.fleet)
        self.tell(f"{number}: {trial}")
        begin = time.time_ns()
        with self._fault(trial):
            # How long it lasts is part of what happens.
            time.sleep(trial.seconds)
        self._until_whole("spare" if trial.of == "base" else "base")
        return begin, time.time_ns()

    def restart(self) -> tuple[int, int]:
        """Restart the coordinators by the script of each host, with no look at them in between; return as `run`."""
        begin = time.time_ns()
        for place in ("spare", "base", "spare"):  # the last two each time need the one that was restarted just before
            prefer(self.machines, self.fleet)
            self.fleet.places[place].run(f"/etc/swarmabs/{_NAME}/restart.sh")
        self._until_whole("base")
        return begin, time.time_ns()

    def close(self) -> None:
        """End the operators."""
        for _, stack in self._operators.values():
            stack.close()
        self._operators.clear()

    def _fault(self, trial: Trial) -> AbstractContextManager[None]:
        if trial.fault == "nothing":
            return nullcontext()
        if trial.fault == "kill":
            return killed(self.fleet.place_of(trial.of), trial.of, self.fleet.unit(trial.of))
        if trial.fault == "pause":
            return paused(self.fleet.place_of(trial.of), trial.of)
        station = self.fleet.places[trial.of]
        if trial.fault == "power":
            if station.name in self._operators:
                self._operators.pop(station.name)[1].close()
            return without_power(station)
        return impaired(station.host, Impairment(trial.delay, loss=float(trial.fault == "cut")), trial.directions)

    def _until_whole(self, seen_from: str) -> None:
        """Wait until one of each pair leads while the other stands by, and both recorders record; by later words."""
        if seen_from not in self._operators:
            stack = ExitStack()
            self._operators[seen_from] = (
                stack.enter_context(self.fleet.operator(self.fleet.places[seen_from], _LIGHT)),
                stack,
            )
        operator = self._operators[seen_from][0]
        before = _counts(operator.look()["diagnostics"])

        def whole() -> bool:
            found = operator.look()["diagnostics"]
            now = _counts(found)
            if any(now.get(node, 0) < before.get(node, 0) + 2 for node in NODES):
                return False
            roles = [
                {found[name(node)]["values"].get("role") for name in (str, standby_name)}
                for node in (OBSERVER, CONTROLLER)
            ]
            return all(role == {"leads", "stands by"} for role in roles)

        until(whole, lambda: f"all pairs are whole, seen from {seen_from}: {operator.look()}", PATIENCE)


def prefer(machines: Hosts, fleet: FleetOnHosts) -> None:
    """Let all that runs come before what starts: hosts of a fleet have processors of their own."""
    running_ = [process for station in fleet.stations for process in _nodes(station).values()]
    for process in [*running_, *(switch.process for switch in machines.switches)]:
        for thread in Path(f"/proc/{process}/task").iterdir():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(int(thread.name), os.SCHED_RR, os.sched_param(1))


def process_of(station: Station, node: str) -> int:
    """Return the process of a node on a host."""
    if (found := _nodes(station).get(node)) is not None:
        return found
    raise AssertionError(f"{node} is not running; {station.log()}")


def _nodes(station: Station) -> dict[str, int]:
    """Return the processes of the nodes on a host, by their names."""
    space = _space(station.host.pid)
    found = {}
    for process in psutil.process_iter(["cmdline"]):
        named = [word for word in process.info["cmdline"] or () if word.startswith(_NAMED)]
        with suppress(OSError):  # it has ended
            if named and _space(process.pid) == space:
                found[named[0].removeprefix(_NAMED)] = process.pid
    return found


def _space(process: int) -> str:
    """Return the process namespace of a process."""
    return str(Path(f"/proc/{process}/ns/pid").readlink())


def _counts(diagnostics: Mapping[str, Mapping[str, int]]) -> dict[str, int]:
    return {node: found["count"] for node, found in diagnostics.items()}


@contextmanager
def killed(station: Station, node: str, unit: str) -> Iterator[None]:
    """Have a node killed, which its unit restarts."""
    os.kill(process_of(station, node), signal.SIGKILL)
    yield
    station.until_active(unit)


@contextmanager
def paused(station: Station, node: str) -> Iterator[None]:
    """Have a node's process stopped."""
    process = process_of(station, node)
    os.kill(process, signal.SIGSTOP)
    yield
    with suppress(ProcessLookupError):  # the service manager has restarted it meanwhile
        os.kill(process, signal.SIGCONT)


@contextmanager
def without_power(station: Station) -> Iterator[None]:
    """Have a host without power."""
    station.host.kill()
    yield
    station.power_on()


@contextmanager
def impaired(host: Host, how: Impairment, directions: tuple[str, ...]) -> Iterator[None]:
    """Have a host whose cable is impaired."""
    host.impair(how, directions=directions)
    yield
    host.impair(PERFECT)


class Outcome(NamedTuple):
    """What the bags say of a trial: longest safe stop of any robot, s, largest angle, rad, and who led at its end."""

    stop: float
    angle: float
    leaders: tuple[tuple[str, ...], ...]

    @property
    def problems(self) -> list[str]:
        found = []
        if self.stop > LONGEST_STOP:
            found.append(f"a robot was stopped for {self.stop:.3g} s")
        if self.angle > CALM:
            found.append(f"the angle reached {self.angle:.3g} rad")
        if any(len(each) != 1 for each in self.leaders):
            found.append(f"at the end led {self.leaders}")
        return found


class Recorded:
    """What a merged bag says of a fleet, by step."""

    def __init__(self, bag: Path) -> None:
        reader = open_bag(bag)
        self._schedule = realtime_world(reader).schedule
        self.stops: list[tuple[int, int, int]] = []
        """Robot, first and last step of each of its safe stops; steps that nobody recorded count to what was before."""
        self._angles: dict[int, float] = {}
        self._broadcast: dict[Topic, dict[int, Message]] = {}
        stopped: dict[int, tuple[int, int]] = {}
        states: list[AgentState] = []
        for topic in (ABSTRACT_STATE, DESIRED_ABSTRACT_STATE):
            self._broadcast |= {topic: {}, STANDBY_TOPICS[topic]: {}}
        self.takeovers = -2  # the first of each pair to lead takes nothing over
        for topic, _, message in reader.decoded({AGENT_STATE, PLANE_STATE, EVENTS, *self._broadcast}):
            if isinstance(message, SwarmEvent):
                self.takeovers += message.kind == EventKind.LEADING
            elif isinstance(message, AgentState):
                states.append(message)
            elif isinstance(message, PlaneState):
                self._angles[message.step] = abs(message.angle)
            else:
                self._broadcast[topic][message.step] = message
        for state in sorted(states, key=lambda each: each.step):
            since = stopped.pop(state.agent_id, None)
            if state.status == Status.SAFE_STOP:
                stopped[state.agent_id] = (since[0] if since else state.step, state.step)
            elif since:
                self.stops.append((state.agent_id, since[0], state.step - 1))
        self.stops += [(robot, *steps) for robot, steps in stopped.items()]

    @property
    def contested(self) -> int:
        """Number of steps in which both of a pair spoke and did not say the same: a mixed set would show there."""
        found = set()
        for topic in (ABSTRACT_STATE, DESIRED_ABSTRACT_STATE):
            one, other = self._broadcast[topic], self._broadcast[STANDBY_TOPICS[topic]]
            found |= {
                step
                for step in one.keys() & other.keys()
                if one[step]._replace(stamp=0) != other[step]._replace(stamp=0)
            }
        return len(found)

    def outcome(self, begin: int, end: int) -> Outcome:
        """Return what happened between two times, ns since 1970."""
        first, last = map(self._schedule.step, (begin, end))
        stops = (min(until_, last) - max(since, first) + 1 for _, since, until_ in self.stops)
        late = range(last - self._schedule.steps(_LED_FOR), last)
        leaders = tuple(
            tuple(
                each.name
                for each in (topic, STANDBY_TOPICS[topic])
                if not self._broadcast[each].keys().isdisjoint(late)
            )
            for topic in (ABSTRACT_STATE, DESIRED_ABSTRACT_STATE)
        )
        angles = (self._angles[step] for step in range(first, last + 1) if step in self._angles)
        return Outcome(max(0, *stops, 0) * self._schedule.period, max(angles), leaders)


class Bags(NamedTuple):
    """The bags of a fleet's two recorders, several of each that was interrupted."""

    one: list[Path]
    other: list[Path]

    @classmethod
    def of(cls, folder: Path) -> "Bags":
        """Return the bags of a fleet in a folder."""
        places = (folder / "disks" / place / "lib" / f"swarmabs-{_NAME}" for place in PLACES)
        return cls(*(sorted(place.glob(f"{_NAME}-*")) for place in places))

    def merge(self, swarm: Path, output: Path) -> list[str]:
        """Merge all in both orders into the folders AB and BA; return what is wrong with the result.

        All nodes on all hosts are silent in a step only if this machine stood still. `verify` shows that no robot acted
        in it: each goes on from its state before.
        """
        problems, still = [], False
        for name, bags in (("AB", [*self.one, *self.other]), ("BA", [*self.other, *self.one])):
            merged = _asked(swarm, "repair", "--merge", *bags, "-o", output / name)
            still = any(gap["topic"] is None for gap in merged["gaps"])
            problems += [f"{name} lacks {gap}" for gap in merged["gaps"] if gap["topic"] is not None]
            problems += [f"{name}: different {place}" for place in merged["contradictions"]]
        contents = [{file.name: file.read_bytes() for file in (output / name).iterdir()} for name in ("AB", "BA")]
        if contents[0] != contents[1]:
            problems.append("the merged bag depends on the order")
        verified = _asked(swarm, "verify", output / "AB")
        if not verified["ok"]:
            problems.append(f"not verified: {verified['first_difference'] or verified['problem']}")
        if still and NO_STATE_BEFORE in verified["not_checkable"]:
            problems.append("steps are missing in which robots acted")
        return problems


def _asked(swarm: Path, *words: object) -> dict[str, Any]:
    """Return what a command line prints as JSON."""
    done = subprocess.run([str(swarm), *map(str, words), "--json"], capture_output=True, text=True, check=False)
    assert done.stdout.startswith("{"), done.stdout + done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@contextmanager
def running(folder: Path, seed: str, tell: Callable[[str], None] = lambda _: None) -> Iterator[Trials]:
    """Have a fleet that has levelled its plane; afterwards it is stopped, and its bags are complete."""
    with hosts(HOSTS, seed=seed) as machines:
        fleet = PairedFleet(machines, folder)
        fleet.install()
        fleet.start()
        trials = Trials(machines, fleet, seed, tell)
        try:
            trials.calm()
            yield trials
        finally:
            trials.close()
        for process in [station.start("systemctl", "stop", "--", fleet.target) for station in fleet.stations]:
            process.wait()


def report(folder: Path, tell: Callable[[str], None]) -> None:
    """Tell what the bags say of the trials of a fleet in a folder."""
    swarm = folder / "checkout" / "scripts" / "swarm"
    tell("; ".join(Bags.of(folder).merge(swarm, folder)) or "the merged bag is complete and verified")
    recorded = Recorded(folder / "AB")
    tell(f"{recorded.takeovers} takeovers; in {recorded.contested} steps both of a pair spoke, and differed")
    for line in (folder / _DONE).read_text(encoding="utf-8").splitlines():
        seed, number, begin, end = json.loads(line)
        outcome = recorded.outcome(begin, end)
        tell(f"{number} {drawn(seed, number)}: {outcome}; {'; '.join(outcome.problems) or 'ok'}")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.hosts.trials", description="Trials of standby coordinators")
    parser.add_argument("folder", type=Path, help="folder of the fleet and its bags; new, or of trials that were done")
    parser.add_argument("--trials", type=int, default=100, help="number of trials; 0: tell only what the bags say")
    parser.add_argument("--first", type=int, default=0, help="number of the first one")
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="time after which no trial is begun any more, s"
    )
    parser.add_argument("--seed", default="1", help="of all that happens")
    options = parser.parse_args()
    if options.trials:
        until_ = time.monotonic() + options.seconds
        with running(options.folder, options.seed, say) as trials, (options.folder / _DONE).open("w") as done:
            for number in range(options.first, options.first + options.trials):
                if time.monotonic() < until_:
                    times = trials.run(number)
                    done.write(json.dumps([options.seed, number, *times]) + "\n")
    else:
        report(options.folder, say)


if __name__ == "__main__":
    main()
