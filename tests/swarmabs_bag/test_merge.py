"""Bags of one run are merged: what any of them holds is there once, what is in none is named, what differs refused.

The pieces are cut from a whole bag, so the whole bag is what a merge must give back; the mcap library reads it.
"""

import errno
import json
import os
import random
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import count, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from tests.swarmabs_bag import sample_run
from tests.swarmabs_bag.answers import command, read_everywhere
from tests.swarmabs_bag.conftest import SCENARIO, STEPS
from tests.swarmabs_bag.mcap_files import rewritten
from tests.swarmabs_bag.realtime_bags import realtime_bag
from tests.swarmabs_core.realtime.bags import world
from tests.virtual.fleet import EPOCH

from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.errors import BagFolderError, BagWriteError, DamagedBagError
from swarmabs_bag.info import bag_info, said_steps
from swarmabs_bag.mcap.output import RecordFile
from swarmabs_bag.merge import ContradictionError, MergeReport, merge_bags
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import RealtimeWorld
from swarmabs_bag.repair.bag import CUT_OFF, repair_bag
from swarmabs_bag.repair.completeness import Gap, RealtimeCompleteness
from swarmabs_bag.repair.spans import Spans
from swarmabs_bag.run.writer import BagWriter
from swarmabs_bag.run_folder import Split
from swarmabs_cli.bags.verify import describe
from swarmabs_config import realtime as configure
from swarmabs_config.configure import members
from swarmabs_config.graph import OFFERED, REALTIME, standby_topic
from swarmabs_core.cdr import decode, encode
from swarmabs_core.errors import InputError
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AGENT_STATE,
    AUXILIARY_STATE,
    BASIS,
    EVENTS,
    PLANE_STATE,
    AbstractState,
    AgentState,
    AuxiliaryState,
    Basis,
    EventKind,
    PlaneState,
    Source,
    SwarmEvent,
    Topic,
)
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.record import Record

OF_RECORDER = {"machine": "x86_64", "standby": "primary"}
PROVENANCE = {"driver": "lockstep", "scenario": "sample", "seed": 5, "versions": {"numpy": "1.26"}, **OF_RECORDER}


class Sent(NamedTuple):
    """A message of a whole bag."""

    topic: Topic
    time: int
    published: int
    payload: bytes

    @property
    def message(self) -> Any:
        return decode(self.topic.message, self.payload)

    @property
    def place(self) -> tuple[str, int, int]:
        """Topic, robot (0: none) and step."""
        message = self.message
        return self.topic.name, message.agent_id if isinstance(message, AgentState) else 0, message.step


def sent(bag: Path) -> list[Sent]:
    return [Sent(*found) for found in open_bag(bag).published()]


def piece(bag: Path, folder: Path, messages: Iterable[Sent], *, aborted: str = "", **changes: Any) -> Path:
    """Write messages as a recorder of a whole bag's run would have; what is changed are attachments or options."""
    whole = open_bag(bag)
    names = ("scenario.yaml", "provenance.json")
    attachments = {name: changes.pop(name, whole.attachment(name)) for name in names}
    messages = list(messages)
    options = {"namespace": whole.namespace, "chunk_bytes": 4000, "qos": OFFERED[REALTIME]} | changes
    topics = dict.fromkeys([*whole.topics(), *(message.topic for message in messages)])
    writer = BagWriter(folder, topics=tuple(topics), attachments=attachments, **options)
    with writer:
        for topic, time, published, payload in messages:
            writer.write(topic, time, payload, published)
        if aborted:
            writer.abort(aborted)
    return folder


def content(folder: Path) -> list[tuple[str, int, int, bytes]]:
    """Return the messages of a bag in file order, as the mcap library reads them."""
    found = []
    for file in sorted(folder.glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2])):
        with file.open("rb") as stream:
            for _, channel, one in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
                found.append((channel.topic, one.log_time, one.publish_time, one.data))
    return found


def same(found: list[tuple[str, int, int, bytes]], expected: list[tuple[str, int, int, bytes]]) -> None:
    """Compare messages: those of the main topics in order; an event that came late may be anywhere after its step."""
    assert Counter(found) == Counter(expected)
    found, expected = ([m for m in each if m[0] != "/swarm/events"] for each in (found, expected))
    assert found == expected


def files(*folders: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for folder in folders for path in sorted(folder.rglob("*")) if path.is_file()}


def merged(pieces: Sequence[Path], to: Path) -> MergeReport:
    """Merge bags in one order and in the other, with the same result, and without a change of the bags."""
    before = files(*pieces)
    report, other = merge_bags(pieces, to), merge_bags(pieces[::-1], to.with_name(f"{to.name}_reversed"))
    assert [*files(to).values()] == [*files(Path(other.output)).values()]
    assert report.bags == other.bags[::-1]
    assert files(*pieces) == before
    assert report.messages == sum(report.topics.values()) == len(read_everywhere(to))
    return report


def named(report: MergeReport) -> set[tuple[str, int, int]]:
    """Return topic, robot and step of every message that is reported to be missing."""
    return {
        (gap.topic or "", robot, step)
        for gap in report.gaps
        for robot in gap.robots or (0,)
        for step in range(gap.first, gap.last + 1)
    }


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of a run in lockstep with an event that came late, and one with text."""
    run = sample_run.make_run(STEPS)
    late = SwarmEvent(5 * sample_run.PERIOD, 5, 1, EventKind.LIMIT_HIT, 0.5, "late")
    place = next(number for number, message in enumerate(run) if message.step == 9)
    attachments = {"scenario.yaml": SCENARIO, "provenance.json": json.dumps(PROVENANCE).encode()}
    run.insert(place, late)
    return sample_run.write_bag(tmp_path_factory.mktemp("whole") / "bag", run, attachments)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag of a virtual fleet."""
    return realtime_bag(tmp_path_factory.mktemp("fleet") / "bag")


def overlapping(draw: random.Random, count: int) -> list[set[int]]:
    begin, end = sorted(draw.randrange(1, count) for _ in range(2))
    return [set(range(end)), set(range(begin, count))]


def adjacent(draw: random.Random, count: int) -> list[set[int]]:
    """Cut between any two messages, also within a step."""
    place = draw.randrange(1, count)
    return [set(range(place)), set(range(place, count))]


def within(draw: random.Random, count: int) -> list[set[int]]:
    """Cut one recorder off for a while, in which there is the other one."""
    begin, end = sorted(draw.randrange(1, count) for _ in range(2))
    return [set(range(begin)) | set(range(end, count)), set(range(begin, end))]


def scattered(draw: random.Random, count: int) -> list[set[int]]:
    """Let each of three recorders miss messages anywhere, but none be missed by all."""
    pieces: list[set[int]] = [set(), set(), set()]
    for number in range(count):
        for one in draw.sample(pieces, draw.randrange(1, 4)):
            one.add(number)
    return pieces


CUTS = (overlapping, adjacent, within, scattered)


@pytest.mark.parametrize("seed", range(4))
def test_however_a_run_is_cut_the_merge_gives_it_back(seed: int, whole: Path, tmp_path: Path) -> None:
    draw, messages = random.Random(seed), sent(whole)
    parts = CUTS[seed % len(CUTS)](draw, len(messages))
    split = Split(nanoseconds=draw.choice((0, 0, 7)) * sample_run.PERIOD)
    pieces = [
        piece(whole, tmp_path / str(n), [messages[i] for i in sorted(part)], split=split)
        for n, part in enumerate(parts)
    ]
    report = merged(pieces, tmp_path / "new")
    same(content(tmp_path / "new"), content(whole))
    assert (report.gaps, report.complete, report.ended_early) == ((), True, None)
    assert repair_bag(tmp_path / "new").output is None
    assert open_bag(tmp_path / "new").attachment("scenario.yaml") == SCENARIO


@pytest.mark.parametrize("seed", range(2))
def test_what_is_in_no_bag_is_named(seed: int, whole: Path, tmp_path: Path) -> None:
    """Lost are all messages of some steps, those of a robot or a topic for a while, and the end of the run."""
    draw, messages = random.Random(seed), sent(whole)
    begin, last = draw.randrange(0, STEPS - 15), draw.randrange(STEPS - 6, STEPS + 1)
    robot, topic = draw.choice(sample_run.AGENTS), draw.choice((PLANE_STATE, ABSTRACT_STATE)).name
    lost = {
        message.place
        for message in messages
        if message.topic is not EVENTS
        and (
            begin <= message.message.step < begin + 3
            or (
                message.place[:2] in {(AGENT_STATE.name, robot), (topic, 0)}
                and begin <= message.message.step < begin + 9
            )
            or message.message.step > last
        )
    }
    left = [message for message in messages if message.place not in lost]
    parts = CUTS[draw.randrange(len(CUTS))](draw, len(left))
    pieces = [
        piece(whole, tmp_path / str(n), [left[i] for i in sorted(part)], aborted=CUT_OFF if last < STEPS else "")
        for n, part in enumerate(parts)
    ]
    report = merged(pieces, tmp_path / "new")
    assert named(report) == lost
    assert not report.complete
    same(content(tmp_path / "new"), [("/" + m.topic.name, *m[1:]) for m in left])
    assert open_bag(tmp_path / "new").aborted() == (CUT_OFF if last < STEPS else None)


def test_what_a_killed_recorder_has_left_is_repaired_first(whole: Path, tmp_path: Path) -> None:
    draw, messages = random.Random(1), sent(whole)
    one = piece(whole, tmp_path / "one", messages[: draw.randrange(200, len(messages))])
    other = piece(whole, tmp_path / "other", messages[draw.randrange(50, 150) :])
    (one / "metadata.yaml").unlink()
    os.truncate(one / "bag_0.mcap", draw.randrange(7000, (one / "bag_0.mcap").stat().st_size // 2))
    shutil.copytree(one, tmp_path / "copy")
    repair_bag(tmp_path / "copy", tmp_path / "saved")
    saved = {m.payload for folder in ("saved", "other") for m in sent(tmp_path / folder)}
    report = merged([one, other], tmp_path / "new")
    same(content(tmp_path / "new"), [("/" + m.topic.name, *m[1:]) for m in messages if m.payload in saved])
    assert named(report) == {m.place for m in messages if m.payload not in saved and m.topic is not EVENTS}
    assert report.bags[0].repaired is not None
    assert report.bags[1].repaired is None
    assert {path.name for path in tmp_path.iterdir()} == {"one", "other", "copy", "saved", "new", "new_reversed"}
    (entry,) = (e for e in provenance(tmp_path / "new")["merged"] if "aborted" in e)
    assert entry["aborted"] == CUT_OFF
    os.truncate(one / "bag_0.mcap", 100)
    with pytest.raises(DamagedBagError, match=r"one/bag_0\.mcap"):
        merge_bags([one, other], tmp_path / "again")
    assert not (tmp_path / "again").exists()


def test_events_that_came_late_are_merged_independently_of_the_order_of_the_bags(whole: Path, tmp_path: Path) -> None:
    """Each recorder has written two events of earlier steps at one place that the other one does not have."""
    messages = sent(whole)
    place = next(n for n, message in enumerate(messages) if message.message.step == 20)

    def late(step: int) -> Sent:
        event = SwarmEvent(step * sample_run.PERIOD, step, 2, EventKind.LIMIT_HIT, 0.5, "late")
        return Sent(EVENTS, event.stamp, event.stamp, encode(event))

    added = ([late(12), late(10)], [late(13), late(11)])
    pieces = [
        piece(whole, tmp_path / str(n), [*messages[:place], *events, *messages[place:]])
        for n, events in enumerate(added)
    ]
    merged(pieces, tmp_path / "new")
    same(content(tmp_path / "new"), [("/" + m.topic.name, *m[1:]) for m in (*messages, *added[0], *added[1])])


@pytest.mark.parametrize("options", [{"compression": CompressionType.LZ4}, {"use_chunking": False}], ids=str)
def test_bags_of_other_writers_are_merged(options: dict[str, Any], whole: Path, tmp_path: Path) -> None:
    other = rewritten(whole, tmp_path / "other.mcap", **options)
    one = piece(whole, tmp_path / "one", sent(whole)[:100])
    assert merged([one, other], tmp_path / "new").complete
    same(content(tmp_path / "new"), content(whole))


@pytest.mark.parametrize("damaged", [False, True], ids=["merging", "repairing"])
@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()], ids=type)
def test_a_merge_that_fails_leaves_nothing_behind(
    error: BaseException, *, damaged: bool, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = Path(shutil.copytree(whole, tmp_path / "copy"))
    if damaged:
        os.truncate(copy / "bag_0.mcap", 9000)
    before = files(tmp_path)

    def fail(self: RecordFile) -> None:
        raise error

    monkeypatch.setattr(RecordFile, "sync", fail)
    with pytest.raises((BagWriteError, KeyboardInterrupt)) as caught:
        merge_bags([whole, copy], tmp_path / "a" / "new")
    if isinstance(error, OSError):
        assert str(caught.value).startswith(f"cannot write {tmp_path}/a/new: full; free space on that disk")
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]
    assert files(tmp_path) == before


def provenance(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(open_bag(folder).attachment("provenance.json") or b"")
    return found


def test_a_merged_bag_says_of_what_it_is_made(whole: Path, tmp_path: Path) -> None:
    """It may be merged once more; of several logs none is lost."""
    messages = sent(whole)
    other = {"machine": "aarch64", "standby": "standby"}
    elsewhere = json.dumps(PROVENANCE | other).encode()
    cuts = (slice(0, 100), slice(90, 150), slice(150, None))
    bags = [piece(whole, tmp_path / str(n), messages[cut]) for n, cut in enumerate(cuts[:2])]
    bags.append(piece(whole, tmp_path / "2", messages[cuts[2]], **{"provenance.json": elsewhere}))
    merged(bags[:2], tmp_path / "first")
    merged([tmp_path / "first", bags[2]], tmp_path / "new")
    same(content(tmp_path / "new"), content(whole))
    first, new = provenance(tmp_path / "first"), provenance(tmp_path / "new")
    assert {name: first[name] for name in PROVENANCE} == PROVENANCE
    assert [entry["messages"] for entry in first["merged"]] == [100, 60]
    assert [entry["steps"] for entry in first["merged"]] == [[[0, 13]], [[12, 21]]]
    assert not new.keys() & other.keys()
    assert [{name: entry[name] for name in other} for entry in new["merged"]] == [OF_RECORDER, other]
    assert new["merged"][0]["merged"] == first["merged"]
    info = bag_info(tmp_path / "new")
    assert info.merged[0].startswith("steps 0 to 21 of ")
    assert (info.complete, len(info.merged), bag_info(whole).merged) == (True, 2, ())
    code, shown = command("info", tmp_path / "new")
    assert code == 0
    assert "merged from" in shown


@pytest.mark.parametrize(
    ("earlier", "later", "same", "ended"),
    [
        ("killed", "", "", None),
        ("", "killed", "killed", "killed"),
        ("stopped", "killed", "killed", "killed"),
        ("stopped", "killed", "", None),
        ("", "killed", "full", "full"),
    ],
)
def test_a_merged_bag_ended_early_if_those_that_end_last_did(
    earlier: str, later: str, same: str, ended: str | None, whole: Path, tmp_path: Path
) -> None:
    messages = [message for message in sent(whole) if message.message.step <= 30]
    parts = ((messages[:100], earlier), (messages[60:], later), (messages[80:], same))
    pieces = [piece(whole, tmp_path / str(n), part, aborted=reason) for n, (part, reason) in enumerate(parts)]
    report = merged(pieces, tmp_path / "new")
    assert (report.ended_early, open_bag(tmp_path / "new").aborted()) == (ended, ended)
    assert {step for *_, step in named(report)} == (set() if ended else set(range(31, STEPS + 1)))


def test_the_bytes_of_a_merged_bag_do_not_depend_on_the_time_that_merging_takes(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = piece(whole, tmp_path / "one", sent(whole)[:200])
    merge_bags([one, whole], tmp_path / "fast")
    monkeypatch.setattr("swarmabs_bag.merge.BagWriter", partial(BagWriter, monotonic=count().__next__))
    merge_bags([one, whole], tmp_path / "slow")
    assert [*files(tmp_path / "fast").values()] == [*files(tmp_path / "slow").values()]


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "no step"), (1, "step 0"), (5, "step 0, steps 10 to 11, step 20, steps 30 to 31, step 40")]
    + [(n, f"step 0, steps 10 to 11, step 20, steps 30 to 31, step 40, {n - 5} more spans") for n in (6, 9)],
)
def test_the_first_spans_of_steps_are_named_and_the_others_counted(count: int, text: str) -> None:
    assert said_steps([(10 * number, 10 * number + number % 2) for number in range(count)]) == text


def test_attachments_of_all_bags_are_kept(whole: Path, tmp_path: Path) -> None:
    run = [message.message for message in sent(whole)]
    attachments = {"scenario.yaml": SCENARIO, "provenance.json": json.dumps(PROVENANCE).encode()}
    for name, logs in (("a", {"run.log": b"one"}), ("b", {"run.log": b"other"}), ("c", {"run-1.log": b"named"})):
        sample_run.write_bag(tmp_path / name, run, attachments, at_end=logs | {"note.txt": b"same"})
    merged([tmp_path / name for name in "bca"], tmp_path / "new")
    bag = open_bag(tmp_path / "new")
    assert {bag.attachment("run-2.log"), bag.attachment("run-3.log")} == {b"one", b"other"}
    assert (bag.attachment("run-1.log"), bag.attachment("note.txt")) == (b"named", b"same")


def another(message: Any) -> Any:
    field = "angle" if isinstance(message, PlaneState) else "position"
    return message._replace(**{field: getattr(message, field) + 1e-9})


@pytest.mark.parametrize(("topic", "later"), [(AGENT_STATE, 0), (PLANE_STATE, 0), (PLANE_STATE, 1)])
def test_bags_in_lockstep_that_contradict_each_other_are_refused(
    topic: Topic, later: int, whole: Path, tmp_path: Path
) -> None:
    messages = sent(whole)
    (place,) = [n for n, m in enumerate(messages) if m.topic is topic and m.message.step == 20][:1]
    found = messages[place]
    forged = another(found.message)._replace(stamp=found.time + later)
    changed = found._replace(payload=encode(forged), time=found.time + later)
    one = piece(whole, tmp_path / "one", messages[:200])
    other = piece(whole, tmp_path / "other", [*messages[100:place], changed, *messages[place + 1 :]])
    robot = " of robot 1" if topic is AGENT_STATE else ""
    for bags in ([one, other], [other, one]):
        with pytest.raises(ContradictionError, match=f"contradict each other: /{topic.name}{robot} at step 20; "):
            merge_bags(bags, tmp_path / "new")
    assert {path.name for path in tmp_path.iterdir()} == {"one", "other"}


def test_bags_contradict_each_other_also_where_a_message_is_late(tmp_path: Path) -> None:
    """What a recorder would still take is compared, however long the run."""
    run = sample_run.make_run(520, agents=(1,))
    attachments = {"scenario.yaml": SCENARIO, "provenance.json": json.dumps(PROVENANCE).encode()}
    whole = sample_run.write_bag(tmp_path / "whole", run, attachments, chunk_bytes=10**6)
    (changed,) = (m for m in sent(whole) if m.topic is PLANE_STATE and m.message.step == 450)
    late = changed._replace(payload=encode(another(changed.message)), time=510 * sample_run.PERIOD)
    other = piece(whole, tmp_path / "other", [late])
    with pytest.raises(ContradictionError, match="/plane/state at step 450; "):
        merge_bags([whole, other], tmp_path / "new")


@pytest.mark.parametrize(
    ("changes", "difference"),
    [
        ({"scenario.yaml": SCENARIO.replace(b"seed: 5", b"seed: 6")}, "scenario.seed is 5 and 6"),
        ({"scenario.yaml": SCENARIO.replace(b"mass: 0.2", b"mass: 0.3")}, "scenario.swarm.agents is "),
        ({"provenance.json": {"driver": "simulate"}}, "driver is 'lockstep' and 'simulate'"),
        ({"provenance.json": {"versions": {"numpy": "2.0"}}}, "versions.numpy is '1.26' and '2.0'"),
        ({"provenance.json": {"steered": True}}, "steered is None and True"),
        ({"namespace": "/lab"}, "namespaces are '/' and '/lab/'"),
        ({"scenario.yaml": b""}, "cannot be merged: it lacks a recorder's scenario or provenance"),
    ],
)
def test_bags_that_are_not_of_one_run_are_refused(
    changes: dict[str, Any], difference: str, whole: Path, tmp_path: Path
) -> None:
    made = changes.get("provenance.json")
    changes = changes if made is None else {"provenance.json": json.dumps(PROVENANCE | made).encode()}
    other = piece(whole, tmp_path / "other", sent(whole), **changes)
    with pytest.raises(InputError, match=difference):
        merge_bags([whole, other], tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["other"]


def test_the_command_says_what_is_missing_and_refuses_what_is_in_the_way(whole: Path, tmp_path: Path) -> None:
    messages = sent(whole)
    one = piece(whole, tmp_path / "one", messages[:100])
    other = piece(whole, tmp_path / "other", [m for m in messages[60:] if m.place[1:] != (7, 20)])
    code, shown = command("repair", "--merge", one, other, "-o", tmp_path / "new")
    assert code == 1
    assert "missing: /swarm/agent_state of robot 7, step 20\n" in shown
    assert f"{one}: 100 messages of steps 0 to 13\n" in shown
    code, shown = command("repair", "--merge", one, whole, "-o", tmp_path / "all", "--json")
    assert (code, json.loads(shown)["gaps"]) == (0, [])
    with pytest.raises(BagFolderError, match="all exists: name a new folder with -o"):
        merge_bags([one, other], tmp_path / "all")
    refused = (
        (one, other),
        ("--merge", one, "-o", tmp_path / "x"),
        ("--merge", one, other),
        ("--merge", one, other, "-o", tmp_path / "x", "--in-place"),
        ("--merge", one, tmp_path / "nothing", "-o", tmp_path / "x"),
        ("--merge", one, other, one / "bag_0.mcap", "-o", tmp_path / "x"),
    )
    for arguments in refused:
        assert command("repair", *arguments)[0] == 2
    assert not (tmp_path / "x").exists()


def test_the_parts_of_a_simulated_run_merge_to_its_digest(tmp_path: Path) -> None:
    whole = tmp_path / "run"
    assert command("simulate", "pd_het_4", "--duration", "0.5", "-o", whole)[0] == 0
    messages = sent(whole)
    one = piece(whole, tmp_path / "one", messages[:250], aborted="killed")
    other = piece(whole, tmp_path / "other", messages[201:])
    assert merged([one, other], tmp_path / "new").complete
    found, expected = BagToVerify(tmp_path / "new").verify(), BagToVerify(whole).verify()
    assert found.ok
    assert found.digest == expected.digest is not None


# Real time


def heard(
    messages: Iterable[Sent], draw: random.Random, keep: Callable[[Sent], bool], jitter: int = 5_000_000
) -> list[Sent]:
    """Return what a recorder has heard of messages: some time later, in its own order."""
    found = [m._replace(time=m.time + draw.randrange(jitter)) for m in messages if keep(m)]
    return sorted(found, key=lambda m: m.time)


def received(*recorders: list[Sent]) -> set[tuple[str, int, int, bytes]]:
    """Return what recorders have heard together, with the earliest time of receipt."""
    first: dict[tuple[Topic, int, bytes], int] = {}
    for topic, time, published, payload in (message for messages in recorders for message in messages):
        key = topic, published, payload
        first[key] = min(time, first.get(key, time))
    return {("/" + topic.name, time, published, payload) for (topic, published, payload), time in first.items()}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.full)])
def test_what_two_recorders_have_heard_of_a_fleet(seed: int, fleet: Path, tmp_path: Path) -> None:
    """Cut off for a while, lossy otherwise; of each message one of them has heard. It verifies as the whole does."""
    draw, messages = random.Random(seed), sent(fleet)
    begin, end = sorted(draw.choice(messages).time for _ in range(2))
    parts: list[set[int]] = [set(), set()]
    for number, message in enumerate(messages):
        hears = draw.choice(((0,), (1,), (0, 1), (0, 1)))
        for each in (1,) if begin <= message.time <= end else hears:
            parts[each].add(number)
    recorders = [heard([messages[i] for i in sorted(part)], draw, lambda _: True) for part in parts]
    pieces = [piece(fleet, tmp_path / str(n), found) for n, found in enumerate(recorders)]
    report = merged(pieces, tmp_path / "new")
    found = content(tmp_path / "new")
    assert len(found) == len(messages)
    assert set(found) == received(*recorders)
    assert [time for _, time, *_ in found] == sorted(time for _, time, *_ in found)
    assert (report.gaps, report.contradictions, report.complete) == ((), (), True)
    verified, before = BagToVerify(tmp_path / "new").verify(), BagToVerify(fleet).verify()
    assert verified.ok
    assert sum(verified.not_checkable.values()) == sum(before.not_checkable.values())


def test_what_no_recorder_of_a_fleet_has_heard(fleet: Path, tmp_path: Path) -> None:
    """Known to be missing is what others name, and what was sent together with it, and steps with nothing at all."""
    messages = sent(fleet)
    steps = sorted({message.message.step for message in messages})
    first = steps[len(steps) // 4]
    silent = range(first + 60, first + 70)

    def hears(message: Sent) -> bool:
        name, robot, step = message.place
        cut_off = (name, robot) == (AGENT_STATE.name, 2) or name == ABSTRACT_STATE.name
        return step not in silent and not (cut_off and first <= step < first + 20)

    draw = random.Random(1)
    halves = [heard(messages, draw, lambda m, n=n: hears(m) and (m.place[2] % 3 != n)) for n in range(2)]
    report = merged([piece(fleet, tmp_path / str(n), half) for n, half in enumerate(halves)], tmp_path / "new")
    expected = {(AGENT_STATE.name, 2), (ABSTRACT_STATE.name, 0)}
    missing = named(report)
    assert {(topic, robot, step) for topic, robot, step in missing if step < silent[0] - 5} == {
        (*stream, step) for stream in expected for step in range(first, first + 20)
    }
    assert {step for topic, _, step in missing if not topic} == set(silent)
    assert all(step in silent for *_, step in missing if step >= first + 20)


def test_what_a_standby_has_said_is_merged_on_its_own_topics(fleet: Path, tmp_path: Path) -> None:
    """From the middle on the observer's standby speaks; each recorder has heard one half of what both have said."""
    messages = sent(fleet)
    middle = messages[len(messages) // 2].message.step

    def speaker(message: Sent) -> Sent:
        found = message.message
        basis = isinstance(found, Basis) and found.source == Source.OBSERVER
        of_observer = basis or message.topic in (ABSTRACT_STATE, AUXILIARY_STATE)
        return message._replace(topic=standby_topic(message.topic)) if of_observer and found.step > middle else message

    said = [speaker(message) for message in messages]
    pieces = [piece(fleet, tmp_path / str(n), said[n::2]) for n in range(2)]
    report = merged(pieces, tmp_path / "new")
    assert Counter(content(tmp_path / "new")) == Counter(("/" + m.topic.name, *m[1:]) for m in said)
    assert report.topics == Counter(m.topic.name for m in said)
    assert report.topics["standby/swarm/abstract_state"] >= 99
    assert report.complete


@pytest.mark.parametrize("name", ["deaths", "operator on a bad network", "begun in a stop"])
def test_a_recorder_that_has_heard_everything_lacks_nothing(name: str) -> None:
    """Robots and coordinators are silent or restart in these worlds, and their network loses messages."""
    recorded = world(name)
    clock = configure.schedule(recorded.scenario, EPOCH)
    found = RealtimeCompleteness(RealtimeWorld(clock, members(recorded.scenario), plane=True))
    for stored in recorded.bag:
        found.add(Record.of(stored.message), stored.time)
    assert found.gaps() == []


@pytest.mark.parametrize(
    ("made", "other"),
    [
        (lambda step: AbstractState(step * sample_run.PERIOD, step, 1, *4 * (0.0,)), AUXILIARY_STATE),
        (lambda step: AuxiliaryState(step * sample_run.PERIOD, step, *8 * (0.0,)), ABSTRACT_STATE),
    ],
    ids=["abstract state", "sums"],
)
def test_what_was_sent_before_the_recorder_heard_anything_is_not_missing(
    made: Callable[[int], AbstractState | AuxiliaryState], other: Topic
) -> None:
    """What an observer publishes at once with what was heard is missing from then on."""
    found = RealtimeCompleteness(RealtimeWorld(Schedule(sample_run.PERIOD), (1,), plane=True))
    for step in (5, 6):
        state = made(step)
        found.add(Record.of(state), state.stamp)
    assert found.gaps() == [Gap(BASIS.name, (), 6, 6), Gap(other.name, (), 6, 6)]


def test_different_messages_in_real_time_are_recorded_by_receipt_and_told(fleet: Path, tmp_path: Path) -> None:
    messages = sent(fleet)
    place = next(n for n, m in enumerate(messages) if m.topic is AGENT_STATE and n > len(messages) // 2)
    kept = messages[place]
    forged = kept._replace(payload=encode(another(kept.message)), time=kept.time + 1000)
    one = piece(fleet, tmp_path / "one", messages)
    other = piece(fleet, tmp_path / "other", [*messages[:place], forged, *messages[place + 1 :]])
    report = merged([one, other], tmp_path / "new")
    ((topic, robot, step),) = report.contradictions
    assert (topic, robot, step) == kept.place
    assert not report.complete
    found = sent(tmp_path / "new")
    added = [m for m in found if m.topic is EVENTS and m.message.kind == EventKind.REFUSED]
    told = [m.message for m in added]
    assert [m.published for m in added] == [e.stamp for e in told]
    assert [(e.step, e.agent_id, e.detail) for e in told] == [
        (
            at,
            robot,
            f"{at_which} different messages of a step, of which the bag has only the first, on {AGENT_STATE.name}",
        )
        for at, at_which in ((step, "from this step on"), (step, "up to this step"))
    ]
    assert kept in found
    assert forged.payload not in {m.payload for m in found}
    assert len(found) == len(messages) + len(told)


def test_bags_of_a_fleet_with_another_epoch_or_a_clock_set_back_are_refused(fleet: Path, tmp_path: Path) -> None:
    messages, made = sent(fleet), provenance(fleet)
    made["realtime"]["epoch_ns"] += 1
    other = piece(fleet, tmp_path / "other", messages, **{"provenance.json": json.dumps(made).encode()})
    with pytest.raises(InputError, match=r"not bags of one run: realtime\.epoch_ns is "):
        merge_bags([fleet, other], tmp_path / "new")
    hour = 3600 * 10**9
    behind = piece(fleet, tmp_path / "behind", [m._replace(time=m.time + hour) for m in messages])
    with pytest.raises(InputError, match=r"behind cannot be merged: at .* its clock is wrong"):
        merge_bags([fleet, behind], tmp_path / "new")


def test_spans_are_a_set() -> None:
    for seed in range(50):
        draw, spans, steps = random.Random(seed), Spans(), set[int]()
        for _ in range(draw.randrange(1, 60)):
            step = draw.randrange(40)
            spans.add(step)
            steps.add(step)
        found = list(spans)
        assert {step for first, last in found for step in range(first, last + 1)} == steps
        assert all(before[1] + 1 < after[0] for before, after in pairwise(found))
        begin, end = sorted(draw.randrange(-2, 45) for _ in range(2))
        missing = {step for first, last in spans.missing(begin, end) for step in range(first, last + 1)}
        assert missing == set(range(begin, end + 1)) - steps
        assert spans.first_missing(begin) == min(set(range(begin, 50)) - steps)
        assert (spans.first, spans.last) == (min(steps), max(steps))


@pytest.mark.system
def test_a_repaired_bag_in_real_time_is_not_complete_nor_is_a_merge_of_such_bags_only(
    fleet: Path, tmp_path: Path
) -> None:
    for chunk in (5, 9):
        damaged = piece(fleet, tmp_path / f"damaged_{chunk}", sent(fleet))
        place = open_bag(damaged).index.chunks[chunk]
        (file,) = damaged.glob("*.mcap")
        with file.open("r+b") as stream:
            stream.seek(place.chunk_start_offset + place.chunk_length - 5)
            stream.write(b"\xff\xff\xff")
        repair_bag(damaged, tmp_path / str(chunk))
        found = BagToVerify(tmp_path / str(chunk)).verify()
        assert (found.ok, found.ended_early, found.complete) == (True, None, False)
        assert "1 place could not be recovered" in (found.lost or "")
        assert "not complete: repaired, " in describe(found)
    merge_bags([tmp_path / "5", tmp_path / "9"], tmp_path / "both")
    merge_bags([tmp_path / "5", fleet], tmp_path / "one")
    assert [BagToVerify(tmp_path / name).verify().complete for name in ("both", "one")] == [False, True]
