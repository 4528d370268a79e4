"""Feed damaged bags to everything that reads bags; started as a program, since it limits its own memory.

``python -m tests.swarmabs_bag.fuzz WHAT FOLDER FIRST NUMBER`` tries the seeds from FIRST on, prints those with
an answer that should not be, and exits 1 if there are any. WHAT is one of `KINDS`, FOLDER an empty folder.
"""

from __future__ import annotations

import random
import resource
import shutil
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn, Protocol

from tests.swarmabs_bag.answers import WrongAnswerError, check_line, command, content
from tests.swarmabs_bag.attempts import Commands, Reading, Repairing
from tests.swarmabs_bag.damage import Damage, damage
from tests.swarmabs_bag.forgery import forge
from tests.swarmabs_bag.split_damage import FolderDamage, damage_folder

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.run_folder import ONE_FILE, Split
from swarmabs_bag.writer import BagWriter
from swarmabs_config.scenario import parse_scenario
from swarmabs_core.errors import SwarmabsError
from swarmabs_core.messages import EVENTS, MAIN_TOPICS
from swarmabs_run.simulation import simulated_steps

MEMORY = 2**28
"""Bytes that an answer may take beyond what the program has when it starts."""
MEMORY_OF_COMMANDS = 2**29
"""The same of commands: to compare scenarios of 65535 robots takes as much."""
SECONDS = 60.0
"""Processor time, s, after which an answer counts as none."""
WAITING = 600.0
"""Time, s, after which it counts as none without any work, such as behind a pipe that nobody writes."""

SCENARIO = """schema: 1
name: sample
duration: 0.4
seed: 5
swarm:
  agents:
    - {id: 1, kind: single_integrator, mass: 0.4, position: 0.1}
    - {id: 2, kind: single_integrator, mass: 0.5, position: -0.1}
    - {id: 7, kind: double_integrator, mass: 0.6, damping: 0.7, position: 0.2}
    - {id: 9, kind: double_integrator, mass: 0.3, damping: 0.7, position: -0.15}
faults:
  - {at: 0.1, kind: join, agent: 9}
  - {at: 0.2, kind: kill, agent: 2}
  - {at: 0.3, kind: leave, agent: 1}
"""
PROVENANCE = b'{"versions": {"swarmabs": "1.2.3"}, "libm_fingerprint": "abc123", "driver": "simulate"}'


class Trial(Protocol):
    """Damages of one kind of bag, and what is tried with them."""

    def make(self, seed: int) -> str:
        """Make the damage of a seed, and return what it is."""
        ...

    def attempt(self, seed: int) -> None:
        """Try it; raise what is no proper answer."""
        ...


def write_bag(folder: Path, split: Split = ONE_FILE) -> Path:
    """Write the bag of a run, with the chunks of a long one."""
    with BagWriter(
        folder,
        topics=(*MAIN_TOPICS, EVENTS),
        attachments={"scenario.yaml": SCENARIO.encode(), "provenance.json": PROVENANCE},
        chunk_bytes=4000,
        chunk_seconds=1e9,
        split=split,
    ) as writer:
        for step in simulated_steps(parse_scenario(SCENARIO)):
            for topic, stamp, payload in step.stored():
                writer.write(topic, stamp, payload)
        writer.close({"run.log": b"all went well\n"})
    return folder


class _OneFile:
    """Damages to one file, of which a part is forged."""

    def __init__(self, folder: Path, attempt: type[Reading | Commands | Repairing], forged: float) -> None:
        whole = write_bag(folder / "whole") / "bag_0.mcap"
        self._data = whole.read_bytes()
        self._attempt = attempt(whole, folder)
        self._forged = forged
        self._damage = Damage("", self._data, sealed=True)

    def make(self, seed: int) -> str:
        make = forge if random.Random(-1 - seed).random() < self._forged else damage
        self._damage = make(self._data, seed)
        return self._damage.name

    def attempt(self, seed: int) -> None:
        self._attempt(self._damage, seed)


class _Split:
    """Damages to a bag of five files."""

    def __init__(self, folder: Path) -> None:
        self._whole = write_bag(folder / "whole", Split(nanoseconds=100_000_000))
        self._bag = folder / "run" / "bag"
        self._bag.parent.mkdir()
        self._content = content(self._whole)
        self._commands = Commands(self._whole, folder, report_every=60)
        self._repairing = Repairing(self._whole, folder)
        self._damage = FolderDamage("", in_files=False)

    def make(self, seed: int) -> str:
        shutil.rmtree(self._bag, ignore_errors=True)
        shutil.copytree(self._whole, self._bag)
        self._damage = damage_folder(self._bag, seed)
        return self._damage.name

    def attempt(self, seed: int) -> None:
        for read in (content, load_arrays):
            try:
                found = read(self._bag)
            except SwarmabsError as error:
                check_line(error)
            else:
                if self._damage.in_files and read is content and found != self._content:
                    raise WrongAnswerError("something else is read")
        code, _ = command("info", self._bag)
        if code == 0 and self._damage.in_files:
            raise WrongAnswerError("the damage is not found")
        if seed % 3 == 0:
            self._commands.on(self._bag, seed)
        self._repairing.on(self._bag, sealed=not self._damage.in_files, in_place=seed % 4 == 0)


KINDS: dict[str, Callable[[Path], Trial]] = {
    "reading": lambda folder: _OneFile(folder, Reading, 0.3),
    "commands": lambda folder: _OneFile(folder, Commands, 0.8),
    "repair": lambda folder: _OneFile(folder, Repairing, 0.3),
    "split": _Split,
}
"""What is tried: reading of one file; verify, compare, replay, export, report; repair; a bag of several files."""


def give_up(*_: object) -> NoReturn:
    raise WrongAnswerError(f"no answer after {SECONDS:g} s of processor time, or {WAITING:g} s of waiting")


def main_program(what: str, folder: Path, first: int, number: int) -> int:
    """Try a range of seeds, and return the exit code."""
    trial = KINDS[what](folder)
    if what in {"commands", "split"}:  # loads what else would count as memory that an answer takes
        Commands(folder / "whole", folder, report_every=1).on(folder / "whole", 0)
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    for limit in (signal.SIGPROF, signal.SIGALRM):
        signal.signal(limit, give_up)
    wrong, most = 0, MEMORY_OF_COMMANDS if what == "commands" else MEMORY
    for seed in range(first, first + number):
        name = trial.make(seed)
        resource.setrlimit(resource.RLIMIT_AS, (used + most, hard))
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        signal.setitimer(signal.ITIMER_REAL, WAITING)
        try:
            trial.attempt(seed)
        except Exception:  # noqa: BLE001 - whatever it is, it is reported
            wrong += 1
            sys.stdout.write(f"seed {seed}, {name}: {traceback.format_exc(limit=-6)[-3000:]}\n")
            sys.stdout.flush()
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
    usage = resource.getrusage(resource.RUSAGE_SELF)
    time = usage.ru_utime + usage.ru_stime
    sys.stdout.write(f"{what}: {number} damages from seed {first} on, {wrong} wrong answers, {time:.0f} s\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main_program(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])))
