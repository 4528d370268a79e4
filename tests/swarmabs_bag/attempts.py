"""What is tried with a damaged bag, and which answers are wrong."""

from __future__ import annotations

import json
import random
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from tests.swarmabs_bag.answers import (
    WrongAnswerError,
    check_line,
    check_with_mcap,
    check_with_rosbags,
    command,
    content,
    extended,
    files_below,
    kept,
    same,
)
from tests.swarmabs_bag.damage import Damage

from swarmabs_analysis.figures.runs import find_runs
from swarmabs_analysis.replay.playback import choose_topics
from swarmabs_analysis.rerun import recorded_run
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.attached import scenario_of
from swarmabs_bag.channels import bag_channel
from swarmabs_bag.errors import NotABagError
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_core.arrays import RunArrays
from swarmabs_core.cdr import encode
from swarmabs_core.errors import InputError, SwarmabsError

Attempt = Callable[[Damage, int], None]
"""Tries a damage and raises what is no proper answer; the number is the seed, by which some choose what they try."""

NODES = ("controller", "observer", "plane", "agent:1", "agent:2", "agent:7", "agent:9", "agent:5")


class Reading:
    """Everything that reads a file.

    Parameters
    ----------
    whole : Path
        The file before the damage.
    folder : Path
        Where the damaged ones are put, one at a time.
    """

    def __init__(self, whole: Path, folder: Path) -> None:
        self._bag = whole.read_bytes()
        self._file = folder / "x.mcap"
        self._output = folder / "output"
        self._content = content(whole)
        self._arrays = load_arrays(whole)
        self._scenario = scenario_of(str(whole))

    def __call__(self, damaged: Damage, seed: int) -> None:
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
        for read_on in (
            lambda: list(open_bag(self._file, damaged=True).decoded()),
            lambda: find_runs([self._file], {"sample"}),
        ):
            try:
                read_on()
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
        code, _ = command("info", self._file)
        again, document = command("info", "--json", self._file)
        if code != again or (code == 0 and not noticed and self._file.read_bytes() != self._bag):
            raise WrongAnswerError(f"swarm info exits {code}, with --json {again}")
        if document:
            json.loads(document)
        try:
            scenario = scenario_of(str(self._file))
        except SwarmabsError as error:
            check_line(error)
            for name in ("run", "simulate"):
                code, _ = command(name, self._file, "-o", self._output)
                if code != (2 if isinstance(error, InputError) else 1) or self._output.exists():
                    raise WrongAnswerError(f"swarm {name} exits {code} after: {error}") from error
        else:
            if not noticed and scenario != self._scenario:
                raise WrongAnswerError("the scenario is another one")


class Commands:
    """The commands that compute something from a bag.

    Parameters
    ----------
    whole : Path
        The bag before the damage.
    folder : Path
        Where results go.
    report_every : int
        How seldom a report is made, which takes long.
    """

    def __init__(self, whole: Path, folder: Path, *, report_every: int = 12) -> None:
        self._whole = whole
        self._arrays = load_arrays(whole)
        self._scenario = scenario_of(str(whole)).resolved()
        self._file = folder / "x.mcap"
        self._output = folder / "output"
        self._report_every = report_every

    def __call__(self, damaged: Damage, seed: int) -> None:
        self._file.write_bytes(damaged.data)
        self.on(self._file, seed)

    def on(self, bag: Path, seed: int) -> None:
        """Try the commands on a bag."""
        generator = random.Random(-seed)
        self._verify(bag)
        self._compare(bag, generator)
        self._replay(bag, generator)
        self._export(bag, generator)
        self._before_starting(bag)
        if seed % self._report_every == 0:
            self._report(bag)

    def _verify(self, bag: Path) -> None:
        code, _ = command("verify", bag)
        again, document = command("verify", "--json", bag)
        if code != again:
            raise WrongAnswerError(f"swarm verify exits {code}, with --json {again}")
        if document and json.loads(document)["ok"] != (code == 0):
            raise WrongAnswerError(f"swarm verify exits {code}, but says {document[:300]}")
        complete = code == 0 and json.loads(document)["complete"]
        if complete and scenario_of(str(bag)).resolved() == self._scenario:
            found = load_arrays(bag)
            if not same(found, self._arrays):
                raise WrongAnswerError("another run of the same scenario is verified")

    def _compare(self, bag: Path, generator: random.Random) -> None:
        bags = [bag, self._whole]
        generator.shuffle(bags)
        code, document = command("compare", *bags, "--json")
        if document and json.loads(document)["equal"] != (code == 0):
            raise WrongAnswerError(f"swarm compare exits {code}")
        again, _ = command("compare", *bags)
        if code != again:
            raise WrongAnswerError(f"swarm compare exits {again}, with --json {code}")
        if code == 0 and _values(bag) != _values(self._whole):
            raise WrongAnswerError("bags with other messages are called equal")
        if code != 2 and generator.random() < 0.1:
            command("compare", bag, bag)

    def _replay(self, bag: Path, generator: random.Random) -> None:
        nodes = generator.sample(NODES, generator.choice((1, 1, 2, 4)))
        options = [part for node in nodes for part in ("--node", node)]
        try:
            code, _ = command("replay", bag, "--in-process", "-o", self._output, *options)
            if self._output.exists() and not (self._output / "summary.json").exists():
                raise WrongAnswerError(f"swarm replay exits {code} and leaves {sorted(self._output.iterdir())}")
            if code == 2 and self._output.exists():
                raise WrongAnswerError("swarm replay refuses, but leaves a folder")
        finally:
            shutil.rmtree(self._output, ignore_errors=True)

    @staticmethod
    def _before_starting(bag: Path) -> None:
        """Find out what would be run again or played, without doing it."""
        for told in (lambda: recorded_run(bag).differences, lambda: choose_topics(open_bag(bag))[1]):
            try:
                lines = told()
            except SwarmabsError as error:
                check_line(error)
            else:
                if not all(line.isprintable() and len(line) < 1000 for line in lines):
                    raise WrongAnswerError(f"a warning that is no line: {max(lines, key=len)[:500]!r}")

    def _export(self, bag: Path, generator: random.Random) -> None:
        form = generator.choice(("csv", "parquet", "numpy"))
        target = self._output.with_name("output.npz") if form == "numpy" else self._output
        self._makes(target, "export", bag, "-o", target, "--format", form)

    def _report(self, bag: Path) -> None:
        if self._makes(self._output, "report", bag, "-o", self._output, "--json", look=self._look_at_report) == 0:
            self._makes(self._output, "report", bag, "-o", self._output)

    @staticmethod
    def _look_at_report(folder: Path) -> None:
        page = (folder / "report.html").read_text(encoding="utf-8")
        if "<script" in page.lower() or "onerror=alert" in page.replace("&lt;img src=x onerror=alert(1)&gt;", ""):
            raise WrongAnswerError("text of the bag is taken for HTML in its report")

    def _makes(self, target: Path, *arguments: str | Path, look: Callable[[Path], None] = lambda _: None) -> int:
        """Run a command that makes something, whole or not at all; remove it, and return the exit code."""
        before = set(files_below(target.parent))
        try:
            code, _ = command(*arguments)
            left = sorted(set(files_below(target.parent)) - before)
            if (code == 0) != target.exists() or (code and left):
                raise WrongAnswerError(f"swarm {arguments[0]} exits {code} and leaves {left}")
            if code == 0:
                look(target)
            return code
        finally:
            if target.is_dir():
                shutil.rmtree(target)
            target.unlink(missing_ok=True)


def _values(bag: Path) -> Counter[bytes]:
    """Return the messages of a bag without what has no meaning, such as padding."""
    return Counter(encode(message) for _, _, message in open_bag(bag).decoded())


class Repairing:
    """Repair of a file or a split bag.

    What comes out opens clean with every reader, and holds nothing that was not in the bag before.

    Parameters
    ----------
    whole : Path
        The bag before the damage.
    folder : Path
        Where damaged and repaired bags are put.
    """

    def __init__(self, whole: Path, folder: Path) -> None:
        self._kept = kept(open_bag(whole))
        self._described = _described(open_bag(whole))
        self._folder = folder / "damaged"
        self._output = folder / "repaired"

    def __call__(self, damaged: Damage, seed: int) -> None:
        self._folder.mkdir()
        try:
            (self._folder / "bag_0.mcap").write_bytes(damaged.data)
            self.on(self._folder, sealed=damaged.sealed, in_place=seed % 4 == 0)
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def on(self, bag: Path, *, sealed: bool, in_place: bool = False) -> None:
        """Repair a bag, and read what comes out."""
        before = {path: _state(path) for path in files_below(bag.parent)}
        try:
            self._into_new_folder(bag, sealed=sealed)
        finally:
            shutil.rmtree(self._output, ignore_errors=True)
        if {path: _state(path) for path in files_below(bag.parent)} != before:
            raise WrongAnswerError(f"a repair leaves {sorted(files_below(bag.parent))}, or changes a file")
        if in_place:
            self._in_place(bag, before, sealed=sealed)

    def _into_new_folder(self, bag: Path, *, sealed: bool) -> None:
        code, document = command("repair", bag, "-o", self._output, "--json")
        if (code == 0) != self._output.exists():
            raise WrongAnswerError(f"swarm repair exits {code}, and the output exists: {self._output.exists()}")
        if code:
            return
        said = json.loads(document)
        found = self._whole_for_everyone(self._output, sealed=sealed)
        if said["messages"] != found:
            raise WrongAnswerError(f"{said['messages']} messages are said to be kept, there are {found}")
        if any(topic["lost"] < 0 for topic in said["topics"]):
            raise WrongAnswerError("fewer than no message lost")
        code, shown = command("repair", self._output)
        shutil.rmtree(self._output.with_name("repaired_repaired"), ignore_errors=True)
        if code or "nothing to do" not in shown:
            raise WrongAnswerError(f"a repaired bag is repaired again: {shown[:500]}")

    def _whole_for_everyone(self, folder: Path, *, sealed: bool) -> int:
        try:
            bag = open_bag(folder)
        except NotABagError as error:  # of which this reader reads one at a time
            if "several swarms" not in str(error) or not sealed:
                raise
            return check_with_mcap(sorted(folder.glob("*.mcap"))).total()
        bag.check()
        info = bag_info(folder)
        if not info.complete:
            raise WrongAnswerError(f"a repaired bag is not complete: {info.problem}")
        found = kept(bag)
        invented = set(found) - set(self._kept)
        if invented and not sealed:
            raise WrongAnswerError(f"{len(invented)} messages are in the repaired bag alone, such as {min(invented)}")
        payloads = Counter(payload for _, _, _, payload in found.elements())
        files = sorted(folder.glob("*.mcap"))
        if not (sealed and any(map(extended, files))) and check_with_mcap(files) != payloads:
            raise WrongAnswerError("the mcap library finds other messages")
        if _described(bag) <= self._described and check_with_rosbags(folder) != payloads:
            raise WrongAnswerError("rosbags finds other messages")
        return found.total()

    def _in_place(self, bag: Path, before: dict[Path, object], *, sealed: bool) -> None:
        code, shown = command("repair", bag, "--in-place")
        if code:
            if {path: _state(path) for path in files_below(bag.parent)} != before:
                raise WrongAnswerError(f"a repair in place that exits {code} leaves {sorted(files_below(bag.parent))}")
            return
        if "nothing to do" in shown:
            return
        self._whole_for_everyone(bag, sealed=sealed)
        for path, state in before.items():
            kept_as = path.with_name(f"{path.name}.damaged")
            if path.is_file() and state not in {_state(path), _state(kept_as) if kept_as.exists() else None}:
                raise WrongAnswerError(f"{path} is neither as it was nor kept")


def _described(bag: BagReader) -> set[tuple[str, ...]]:
    """Return what a bag says of its topics and itself; what no robot has said is not for every reader to accept."""
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
