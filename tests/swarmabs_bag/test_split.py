"""A bag in several files: each complete in itself, and all of them one run."""

from __future__ import annotations

import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.attached import scenario_of
from swarmabs_bag.errors import BagWriteError, DamagedBagError, NotABagError
from swarmabs_bag.info import bag_info
from swarmabs_bag.reader import open_bag
from swarmabs_bag.repair import repair_bag
from swarmabs_bag.run_folder import Split, find_bag
from swarmabs_bag.writer import BagWriter
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, TOPIC_OF, Message

PERIOD = 10_000_000
SCENARIO = b"schema: 1\nname: split\nswarm: {generate: {single_integrator: 2}}\n"


def writer(folder: Path, split: Split) -> BagWriter:
    return BagWriter(
        folder,
        topics=(*MAIN_TOPICS, EVENTS),
        attachments={"scenario.yaml": SCENARIO},
        chunk_bytes=2000,
        split=split,
    )


def write_all(bag: BagWriter, run: list[Message]) -> None:
    with bag:
        for message in run:
            bag.write(TOPIC_OF[type(message)], message.stamp, encode(message))
        bag.close({"run.log": b"all went well\n"})


def write(folder: Path, run: list[Message], split: Split) -> list[Path]:
    write_all(writer(folder, split), run)
    return sorted(folder.glob("*.mcap"))


@pytest.fixture
def files(tmp_path: Path, run: list[Message]) -> list[Path]:
    """Return the files of the run of 41 steps, 10 of them in each."""
    return write(tmp_path / "bag", run, Split(nanoseconds=10 * PERIOD))


def test_each_file_is_complete_in_itself_and_all_are_the_run(files: list[Path], run: list[Message]) -> None:
    assert [file.name for file in files] == [f"bag_{number}.mcap" for number in range(5)]
    payloads = []
    for number, file in enumerate(files):
        alone = open_bag(file)
        alone.check()
        assert alone.attachment("scenario.yaml") == SCENARIO
        assert tuple(entry.name for entry in alone.index.attachments)[1:] == (("run.log",) if number == 4 else ())
        with file.open("rb") as stream:
            found = [
                (m.log_time // PERIOD, m.data) for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()
            ]
        assert {step // 10 for step, _ in found} == {number}
        with Reader(file) as other:
            assert other.message_count == len(found) == alone.message_count
            assert len(other.connections) == 6
        payloads += [payload for _, _, payload in alone.messages()]
    assert payloads == [encode(message) for message in run]


def test_all_files_together_are_read_as_one(files: list[Path], run: list[Message], bag: Path) -> None:
    whole, split = open_bag(bag), open_bag(files[0].parent)
    split.check()
    assert list(split.messages()) == list(whole.messages())
    assert split.channels == whole.channels
    assert (split.start, split.end, split.message_count) == (0, run[-1].stamp, len(run))
    assert tuple(entry.name for entry in split.index.attachments) == ("scenario.yaml", "run.log")
    assert split.attachment("run.log") == b"all went well\n"
    one, several = load_arrays(bag), load_arrays(files[0].parent)
    assert np.array_equal(one.angle, several.angle)
    assert np.array_equal(one.agents.position, several.agents.position)
    info = bag_info(files[0].parent)
    assert (info.complete, info.size) == (True, sum(file.stat().st_size for file in files))
    with Reader(files[0].parent) as other:
        assert sum(1 for _ in other.messages()) == len(run)


def test_metadata_lists_the_files_as_rosbag2_does(files: list[Path], run: list[Message]) -> None:
    found = yaml.safe_load((files[0].parent / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert found["relative_file_paths"] == [file.name for file in files] == [entry["path"] for entry in found["files"]]
    starts = [entry["starting_time"]["nanoseconds_since_epoch"] for entry in found["files"]]
    assert starts == [number * 10 * PERIOD for number in range(5)]
    assert [entry["duration"]["nanoseconds"] for entry in found["files"]] == [9 * PERIOD] * 4 + [0]
    assert sum(entry["message_count"] for entry in found["files"]) == found["message_count"] == len(run)
    assert found["duration"]["nanoseconds"] == run[-1].stamp
    assert {entry["message_count"] for entry in found["topics_with_message_count"]} == {123, 41, 1}


def test_split_by_size_ends_files_between_steps(tmp_path: Path, run: list[Message]) -> None:
    files = write(tmp_path / "bag", run, Split(bytes=20_000))
    assert len(files) > 1
    assert all(file.stat().st_size > 20_000 for file in files[:-1])
    steps = [{time // PERIOD for _, time, _ in open_bag(file).messages()} for file in files]
    assert sorted(step for part in steps for step in part) == list(range(41))
    assert [payload for _, _, payload in open_bag(tmp_path / "bag").messages()] == [encode(message) for message in run]


def test_a_bag_that_is_split_is_run_again_as_a_whole_or_from_one_file(files: list[Path]) -> None:
    for named in (files[0].parent, files[2]):
        assert scenario_of(str(named)).name == "split"


def test_files_that_do_not_belong_together_are_not_read_as_one(files: list[Path]) -> None:
    files[1].rename(files[1].with_name("other_1.mcap"))
    with pytest.raises(NotABagError, match=r"holds 5 \.mcap files: name one of them"):
        find_bag(files[0].parent)


def test_a_swarm_need_not_be_in_every_file(tmp_path: Path, run: list[Message], write_bag: Callable[..., Path]) -> None:
    """A recorder that writes down what it hears names a topic first in the file in which it is first heard."""
    (tmp_path / "both").mkdir()
    for number, name in enumerate(("east", "west")):
        write_bag(tmp_path / name, namespace=f"/{name}")
        (tmp_path / name / "bag_0.mcap").rename(tmp_path / "both" / f"bag_{number}.mcap")
    for name in ("east", "west"):
        assert len(list(open_bag(tmp_path / "both", namespace=name).messages())) == len(run)
    for namespace, text in ((None, "several swarms: choose one with --namespace: /east, /west"), ("/", "in /east")):
        with pytest.raises(NotABagError, match=text):
            open_bag(tmp_path / "both", namespace=namespace)


def test_a_file_that_is_missing_is_named(files: list[Path], run: list[Message]) -> None:
    files[1].unlink()
    with pytest.raises(DamagedBagError, match=r"bag_1\.mcap is missing"):
        open_bag(files[0].parent)
    info = bag_info(files[0].parent)
    assert info.problem == "bag_1.mcap is missing"
    assert info.message_count == len(run) - 70


def test_a_number_far_behind_the_others(files: list[Path], tmp_path: Path) -> None:
    files[4].rename(files[4].with_name("bag_999999999.mcap"))
    named = r"bag_4\.mcap is missing, bag_5\.mcap is missing, bag_6\.mcap is missing; name one"
    with pytest.raises(DamagedBagError, match=named):
        open_bag(files[0].parent)
    assert len(repair_bag(files[0].parent, tmp_path / "new").problems) == 3


@pytest.mark.parametrize("left", [0, 20, 1000])
def test_a_killed_split_is_read_as_far_as_it_goes(left: int, files: list[Path], run: list[Message]) -> None:
    for file in (*files[3:], files[0].with_name("metadata.yaml")):
        file.unlink()
    os.truncate(files[2], left)
    with pytest.raises(DamagedBagError, match=r"bag_2\.mcap"):
        open_bag(files[0].parent)
    found = [payload for _, _, payload in open_bag(files[0].parent, damaged=True).messages()]
    assert found == [encode(message) for message in run[: len(found)]]
    assert len(found) == 141


@contextmanager
def no_free_descriptor() -> Iterator[None]:
    """Use up all file descriptors of this process."""
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(int(entry.name) for entry in Path("/proc/self/fd").iterdir())
    taken: list[int] = []
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 2, limits[1]))
    try:
        with suppress(OSError):
            while True:
                taken.append(os.open("/dev/null", os.O_RDONLY))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
        for descriptor in taken:
            os.close(descriptor)


def test_without_a_free_descriptor_a_bag_is_not_begun(tmp_path: Path) -> None:
    with no_free_descriptor(), pytest.raises(BagWriteError, match=r"bag_0\.mcap: Too many open files; raise the limit"):
        writer(tmp_path / "bag", Split())
    assert not list(tmp_path.iterdir())


def test_without_a_free_descriptor_a_split_bag_is_complete_up_to_there(tmp_path: Path, run: list[Message]) -> None:
    bag = writer(tmp_path / "bag", Split(nanoseconds=10 * PERIOD))
    with (
        no_free_descriptor(),
        pytest.raises(BagWriteError, match=r"bag_1\.mcap: Too many open files; raise the limit"),
    ):
        write_all(bag, run)
    assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == ["bag_0.mcap", "metadata.yaml"]
    found = open_bag(tmp_path / "bag")
    found.check()
    assert "Too many open files" in (found.aborted() or "")
    payloads = [payload for _, _, payload in found.messages()]
    assert payloads == [encode(message) for message in run[: len(payloads)]]
    assert len(payloads) > 60
    with Reader(tmp_path / "bag") as other:
        assert other.message_count == len(payloads)
