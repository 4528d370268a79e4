"""Feed damaged bags to everything that reads bags; started as a program, since it limits its own memory.

``python -m tests.swarmabs_bag.fuzz WHAT FOLDER FIRST NUMBER`` tries the seeds from FIRST on, prints those with
an answer that should not be, and exits 1 if there are any. WHAT is one of `KINDS`, FOLDER an empty folder.
"""

import json
import random
import resource
import shutil
import signal
import sys
import traceback
from abc import ABC, abstractmethod
from collections import Counter
from pathlib import Path
from typing import NoReturn

from tests.swarmabs_bag.answers import (
    WrongAnswerError,
    check_with_mcap,
    check_with_rosbags,
    command,
    content,
    kept,
    tried,
)
from tests.swarmabs_bag.conftest import PROVENANCE, SCENARIO
from tests.swarmabs_bag.damage import Damage, damage_bag
from tests.swarmabs_bag.sample_run import bag_writer

from swarmabs_analysis.figures.runs import find_runs
from swarmabs_analysis.replay.playback import choose_topics
from swarmabs_analysis.rerun import recorded_run
from swarmabs_bag.arrays import digest_of, load_arrays, load_messages
from swarmabs_bag.attached import scenario_of
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.channels import bag_channel
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError, SwarmabsError
from swarmabs_core.messages import STANDING
from swarmabs_run.simulation import simulated_steps

SECONDS = 60.0
"""Processor time, s, after which an answer counts as none."""
WAITING = 600.0
"""Time, s, after which it counts as none without any work, such as behind a pipe that nobody writes."""

NODES = ("controller", "observer", "plane", "agent:1", "agent:2", "agent:7", "agent:9", "agent:5")
MORE = b"""    - {id: 9, kind: double_integrator, mass: 0.3, damping: 0.7, position: -0.15}
faults:
  - {at: 0.1, kind: join, agent: 9}
  - {at: 0.2, kind: kill, agent: 2}
  - {at: 0.3, kind: leave, agent: 1}
"""


def write_bag(folder: Path, split: Split = ONE_FILE) -> Path:
    """Write the bag of a run, with the chunks of a long one."""
    scenario = SCENARIO + MORE
    attached = {"scenario.yaml": scenario, "provenance.json": PROVENANCE}
    with bag_writer(folder, attached, more=(STANDING,), chunk_bytes=4000, chunk_seconds=1e9, split=split) as writer:
        for step in simulated_steps(parse_scenario(scenario.decode())):
            for topic, stamp, payload in step.stored():
                writer.write(topic, stamp, payload)
        writer.close({"run.log": b"all went well\n"})
    return folder


class Trial(ABC):
    """Damages to bags of one and of five files, and what is tried with them."""

    forged = 0.3
    memory = 2**28
    """Bytes that an answer may take beyond what the program has when it starts."""

    def __init__(self, folder: Path) -> None:
        self.bag, self.output = folder / "run" / "bag", folder / "output"
        self._wholes = [write_bag(folder / "one"), write_bag(folder / "five", Split(nanoseconds=100_000_000))]
        self.whole = self._wholes[0]
        whole = open_bag(self.whole)
        self.content, self.kept, self.described = content(self.whole), kept(whole), _described(whole)
        self.damage = Damage("", noticeable=False)
        self.draw = random.Random()

    def make(self, seed: int) -> str:
        """Make the damage of a seed, and return what it is."""
        self.draw = random.Random(seed)
        self.whole = self.draw.choice(self._wholes)
        for folder in (self.bag.parent, self.output):
            shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self.whole, self.bag)
        self.damage = damage_bag(self.bag, self.draw, self.forged)
        return self.damage.name

    def warm_up(self) -> None:
        """Load what would else count as memory that an answer takes."""
        shutil.copytree(self.whole, self.bag)
        self.attempt()

    @abstractmethod
    def attempt(self) -> None:
        """Try it; raise what is no proper answer."""

    def left(self) -> dict[Path, object]:
        """Return everything that is there, with its content."""
        return {path: _state(path) for path in self.output.parent.rglob("*")}


class Reading(Trial):
    """Everything that reads a bag."""

    def attempt(self) -> None:
        """Read a bag as one that is whole, and as far as it can be read."""
        checked = tried(lambda: open_bag(self.bag).check())
        found = tried(lambda: content(self.bag))
        tried(lambda: load_arrays(self.bag))
        if self.damage.noticeable and not isinstance(found, SwarmabsError) and found != self.content:
            raise WrongAnswerError("something else is read")
        if self.damage.noticeable and not isinstance(checked, SwarmabsError):
            raise WrongAnswerError("the damage is not found")
        tried(lambda: content(self.bag, damaged=True))
        tried(lambda: load_arrays(self.bag, damaged=True))
        tried(lambda: list(open_bag(self.bag, damaged=True).decoded()))
        tried(lambda: find_runs([self.bag], {"sample"}))
        info = tried(lambda: bag_info(self.bag))
        if not isinstance(info, SwarmabsError) and info.complete != (info.problem is None):
            raise WrongAnswerError(f"a bag is complete: {info.complete}, but {info.problem}")
        code, _ = command("info", self.bag)
        again, document = command("info", "--json", self.bag)
        if code != again or (document and json.loads(document)["complete"] != (code == 0)):
            raise WrongAnswerError(f"swarm info exits {code}, with --json {again}")
        scenario = tried(lambda: scenario_of(str(self.bag)))
        for name in ("run", "simulate") if isinstance(scenario, SwarmabsError) else ():
            code, _ = command(name, self.bag, "-o", self.output)
            if code != (2 if isinstance(scenario, InputError) else 1) or self.output.exists():
                raise WrongAnswerError(f"swarm {name} exits {code} after: {scenario}")


class Commands(Trial):
    """The commands that compute something from a bag."""

    forged = 0.8
    memory = 2**29  # to compare scenarios of 65535 robots takes as much

    def attempt(self) -> None:
        """Verify, compare, export and report a bag; see what would be run again or played."""
        code = self._judge("verify", "ok", self.bag)
        if code == 0 and tried(lambda: scenario_of(str(self.bag))) == scenario_of(str(self.whole)):
            digests = [digest_of(load_messages(open_bag(bag)).tables) for bag in (self.bag, self.whole)]
            if bag_info(self.bag).complete and digests[0] != digests[1] and not bag_info(self.bag).aborted:
                raise WrongAnswerError("another run of the same scenario is verified")
        bags = self.draw.sample([self.bag, self.whole], 2)
        if self._judge("compare", "equal", *bags) == 0 and _values(self.bag) != _values(self.whole):
            raise WrongAnswerError("bags with other messages are called equal")
        nodes = self.draw.sample(NODES, self.draw.choice((1, 1, 2, 4)))
        self._judge("verify", "ok", self.bag, *(part for node in nodes for part in ("--node", node)))
        self._makes("export", "--format", self.draw.choice(("csv", "parquet")))
        if self.draw.random() < 0.1:  # takes long
            self._makes("report", "--json")
        for told in (lambda: recorded_run(self.bag).differences, lambda: choose_topics(open_bag(self.bag))[1]):
            lines = tried(told)
            if not isinstance(lines, SwarmabsError) and not all(line.isprintable() for line in lines):
                raise WrongAnswerError(f"a warning that is no line: {lines!r:.500}")

    def _judge(self, name: str, key: str, *words: Path | str) -> int:
        code, _ = command(name, *words)
        again, document = command(name, *words, "--json")
        if code != again or (document and json.loads(document)[key] != (code == 0)):
            raise WrongAnswerError(f"swarm {name} exits {code}, with --json {again} and says {document[:300]}")
        return code

    def _makes(self, name: str, *options: str) -> None:
        """Run a command that makes something, whole or not at all, and remove it."""
        before = self.left()
        code, _ = command(name, self.bag, "-o", self.output, *options)
        made = code == 0
        if made != self.output.exists() or (not made and self.left() != before):
            raise WrongAnswerError(f"swarm {name} exits {code} and leaves {sorted(self.left())}")
        page = self.output / "report.html"
        if page.exists() and "<script" in page.read_text(encoding="utf-8").lower():
            raise WrongAnswerError("text of the bag is taken for HTML in its report")
        shutil.rmtree(self.output, ignore_errors=True)


class Repairing(Trial):
    """Repair: what comes out opens clean with every reader, and holds nothing that was not in the bag before."""

    def attempt(self) -> None:
        """Repair a bag into a new folder and in place, and read what comes out."""
        before = self.left()
        code, document = command("repair", self.bag, "-o", self.output, "--json")
        if (code == 0) != self.output.exists():
            raise WrongAnswerError(f"swarm repair exits {code}, and the output exists: {self.output.exists()}")
        if code == 0:
            said = json.loads(document)
            if said["messages"] != self._is_whole(self.output, said["undecided"]):
                raise WrongAnswerError(f"{said['messages']} messages are said to be kept")
            if any(topic["lost"] < 0 for topic in said["topics"]):
                raise WrongAnswerError("fewer than no message lost")
            code, shown = command("repair", self.output)
            if code or "nothing to repair" not in shown:
                raise WrongAnswerError(f"a repaired bag is repaired again: {shown[:500]}")
            shutil.rmtree(self.output)
        if self.left() != before:
            raise WrongAnswerError(f"a repair leaves {sorted(self.left())}, or changes a file")
        code, document = command("repair", self.bag, "--in-place", "--json")
        if code and self.left() != before:
            raise WrongAnswerError(f"a repair in place that exits {code} leaves {sorted(self.left())}")
        if code == 0 and json.loads(document)["output"] is not None:
            self._is_whole(self.bag, json.loads(document)["undecided"])
            after = self.left()
            for path, state in before.items():
                if state not in {after.get(path), after.get(path.with_name(f"{path.name}.damaged"))}:
                    raise WrongAnswerError(f"{path} is neither as it was nor kept")

    def _is_whole(self, folder: Path, undecided: str | None) -> int:
        """Check that every reader finds the same; return the number of messages."""
        bag = open_bag(folder, several=True)
        bag.check()
        if bag_info(folder).problem != undecided:
            raise WrongAnswerError(f"of a repaired bag info says {bag_info(folder).problem}, repair {undecided}")
        found = kept(bag)
        invented = set(found) - set(self.kept)
        if self.damage.noticeable and invented:
            raise WrongAnswerError(f"{len(invented)} messages are in the repaired bag alone, such as {min(invented)}")
        if _described(bag) <= self.described:  # what no robot has said of a topic is not for every reader to accept
            payloads = Counter(payload for _, _, _, payload in found.elements())
            if check_with_rosbags(folder) != payloads or check_with_mcap(sorted(folder.glob("*.mcap"))) != payloads:
                raise WrongAnswerError("other readers find other messages")
        return found.total()


class Merging(Trial):
    """A merge with the whole bag of another recorder: all of the run and nothing else, or nothing."""

    memory = 2**29

    def attempt(self) -> None:
        """Merge both into a new folder."""
        before = self.left()
        code, _ = command("repair", "--merge", *self.draw.sample([self.bag, self.whole], 2), "-o", self.output)
        made = self.output.exists()
        if (made and code == 2) or (code == 0 and not made):
            raise WrongAnswerError(f"swarm repair --merge exits {code}, and the output exists: {made}")
        if made:
            bag = open_bag(self.output)
            bag.check()
            if self.damage.noticeable and (kept(bag) != self.kept or code):
                raise WrongAnswerError(f"swarm repair --merge exits {code}, and the merged bag has other messages")
            shutil.rmtree(self.output)
        if self.left() != before:
            raise WrongAnswerError(f"a merge leaves {sorted(self.left())}, or changes a file")


def _values(bag: Path) -> Counter[bytes]:
    """Return the messages of a bag without what has no meaning, such as padding."""
    return Counter(encode(message) for _, _, message in open_bag(bag).decoded())


def _described(bag: BagReader) -> set[tuple[str, ...]]:
    """Return what a bag says of its topics and itself."""
    found: set[tuple[str, ...]] = set()
    for part in bag.files:
        channels = [bag_channel(channel, part.index) for channel in part.index.channels.values()]
        found |= {(c.name, c.ros_type, c.type_hash, c.qos_profiles, c.encoding) for c in channels}
        found |= {(schema.name, schema.encoding, schema.data.hex()) for schema in part.index.schemas.values()}
        found.add((part.index.header.profile,))
    return found


def _state(path: Path) -> object:
    """Return what a file holds, or what else it is."""
    if path.is_symlink() or not path.is_file():
        return path.is_symlink(), path.is_dir(), path.is_fifo()
    return path.read_bytes()


KINDS: dict[str, type[Trial]] = {"reading": Reading, "commands": Commands, "repair": Repairing, "merge": Merging}


def give_up(*_: object) -> NoReturn:
    raise WrongAnswerError(f"no answer after {SECONDS:g} s of processor time, or {WAITING:g} s of waiting")


def main_program(what: str, folder: Path, first: int, number: int) -> int:
    """Try a range of seeds, and return the exit code."""
    trial = KINDS[what](folder)
    trial.warm_up()
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    for limit in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(limit, give_up)
    wrong = 0
    for seed in range(first, first + number):
        name = trial.make(seed)
        resource.setrlimit(resource.RLIMIT_AS, (used + trial.memory, hard))
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        signal.setitimer(signal.ITIMER_REAL, WAITING)
        try:
            trial.attempt()
        except Exception:  # noqa: BLE001 - whatever it is, it is reported
            wrong += 1
            sys.stdout.write(f"seed {seed}, {name}: {traceback.format_exc(limit=-6)[-3000:]}\n")
            sys.stdout.flush()
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
    sys.stdout.write(f"{what}: {number} damages from seed {first} on, {wrong} wrong answers\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main_program(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])))
