"""Feed damaged bags to everything that reads bags; started as a program, since it limits its own memory.

``python fuzz.py BAG FOLDER FIRST NUMBER`` tries the seeds from FIRST on, prints those with an answer that should not
be, and exits 1 if there are any.
"""

from __future__ import annotations

import hashlib
import io
import json
import resource
import signal
import sys
import traceback
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NoReturn

import numpy as np

from swarmabs_bringup.bag import bag_info, load_arrays, open_bag
from swarmabs_bringup.cli import main
from swarmabs_bringup.figures.runs import find_runs
from swarmabs_bringup.scenarios import find_scenario
from swarmabs_core.arrays import RunArrays
from swarmabs_core.errors import InputError, SwarmabsError

sys.path.insert(0, str(Path(__file__).parent))
from damage import Damage, damage

MEMORY = 2**28
"""Bytes that an answer may take beyond what the program has when it starts."""
SECONDS = 60.0
"""Processor time, s, after which an answer counts as none."""

Content = tuple[str, dict[str, bytes | None]]
"""Digest of all messages in file order, and the attachments."""


class WrongAnswerError(Exception):
    """Something read a damaged bag and gave an answer that should not be."""


def content(path: Path, *, damaged: bool = False) -> Content:
    bag = open_bag(path, damaged=damaged)
    digest = hashlib.sha256()
    for channel, message in bag.stored_messages():
        digest.update(f"{channel.name} {message.log_time} {len(message.payload)} ".encode() + message.payload)
    attachments = {name: bag.attachment(name) for name in bag.attachment_names()}
    bag.rosbag2_metadata()
    bag.aborted()
    return digest.hexdigest(), attachments


def command(*arguments: str) -> tuple[int, str]:
    """Return exit code and standard output of a command; what it says besides is one line of error."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(list(arguments))
    said = err.getvalue()
    one_line = said.startswith("error: ") and said.endswith("\n") and said[:-1].isprintable() and len(said) < 2000
    if code not in {0, 1, 2} or (not one_line if said else code != 0 and not out.getvalue()):
        raise WrongAnswerError(f"swarm {' '.join(arguments)} exits {code} and says {said[:500]!r}")
    return code, out.getvalue()


def same(one: RunArrays, other: RunArrays) -> bool:
    """Say whether two runs have the same states of robots and plane."""
    return all(
        np.array_equal(getattr(one.agents, name), getattr(other.agents, name), equal_nan=True)
        for name in ("ids", "status", "position", "command")
    ) and np.array_equal(one.angle, other.angle, equal_nan=True)


class Fuzzer:
    """Tries damages on one bag.

    Parameters
    ----------
    bag : bytes
        The whole bag.
    folder : Path
        Where the damaged ones are put, one at a time.
    """

    def __init__(self, bag: bytes, folder: Path) -> None:
        self._bag = bag
        self._file = folder / "x.mcap"
        self._output = folder / "output"
        self._file.write_bytes(bag)
        self._content = content(self._file)
        self._arrays = load_arrays(self._file)
        self._scenario = find_scenario(str(self._file))

    def attempt(self, damaged: Damage) -> None:
        """Try one damage.

        Raises
        ------
        Exception
            Whatever is no proper answer.
        """
        self._file.write_bytes(damaged.data)
        noticed = self._read(damaged)
        self._scan()
        self._commands(noticed=noticed or damaged.sealed)

    def _read(self, damaged: Damage) -> bool:
        """Read a bag as one that is whole, and say whether the damage was noticed."""
        noticed = False
        for read, expected in ((content, self._content), (load_arrays, self._arrays)):
            try:
                found = read(self._file)
            except SwarmabsError as error:
                check_line(error)
                noticed = True
                continue
            equal = same(found, expected) if isinstance(found, RunArrays) else found == expected
            if not equal and not damaged.sealed:
                raise WrongAnswerError(f"{read.__name__} reads something else")
        try:
            open_bag(self._file).check()
        except SwarmabsError as error:
            check_line(error)
            return True
        if not damaged.sealed and damaged.data != self._bag:
            raise WrongAnswerError("the damage is not found")
        return noticed

    def _scan(self) -> None:
        """Read what can be read of a bag whose damage is known."""
        for read in (content, load_arrays):
            try:
                read(self._file, damaged=True)
            except SwarmabsError as error:
                check_line(error)
        try:
            for _ in open_bag(self._file, damaged=True).decoded():
                pass
            find_runs([self._file], {"sample"})
        except SwarmabsError as error:
            check_line(error)
        try:
            info = bag_info(self._file)
        except SwarmabsError as error:
            check_line(error)
        else:
            if not info.complete and not info.problem:
                raise WrongAnswerError("a bag is not complete, but there is no problem")

    def _commands(self, *, noticed: bool) -> None:
        code, _ = command("info", str(self._file))
        again, document = command("info", "--json", str(self._file))
        if code != again or (code == 0 and not noticed and self._file.read_bytes() != self._bag):
            raise WrongAnswerError(f"swarm info exits {code}, with --json {again}")
        if document:
            json.loads(document)
        command("verify", str(self._file))
        try:
            scenario = find_scenario(str(self._file))
        except SwarmabsError as error:
            check_line(error)
            for name in ("run", "simulate"):
                code, _ = command(name, str(self._file), "-o", str(self._output))
                if code != (2 if isinstance(error, InputError) else 1) or self._output.exists():
                    raise WrongAnswerError(f"swarm {name} exits {code} after: {error}") from error
        else:
            if not noticed and scenario != self._scenario:
                raise WrongAnswerError("the scenario is another one")


def check_line(error: SwarmabsError) -> None:
    """Make sure that an error is one short line that cannot steer a terminal."""
    if not str(error).isprintable() or len(str(error)) > 1000:
        raise WrongAnswerError(f"an error of {len(str(error))} characters: {str(error)[:300]!r}")


def give_up(*_: object) -> NoReturn:
    raise WrongAnswerError(f"no answer after {SECONDS:g} s of processor time")


def main_program(bag: Path, folder: Path, first: int, number: int) -> int:
    """Try a range of seeds, and return the exit code."""
    fuzzer = Fuzzer(bag.read_bytes(), folder)
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    signal.signal(signal.SIGPROF, give_up)
    wrong = 0
    for seed in range(first, first + number):
        made = damage(bag.read_bytes(), seed)
        resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, hard))
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            fuzzer.attempt(made)
        except Exception:  # noqa: BLE001 - whatever it is, it is reported
            wrong += 1
            sys.stdout.write(f"seed {seed}, {made.name}: {traceback.format_exc(limit=-6)}\n")
            sys.stdout.flush()
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
    sys.stdout.write(f"{number} damages, {wrong} wrong answers\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main_program(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])))
