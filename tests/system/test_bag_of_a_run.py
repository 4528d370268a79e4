"""The bag of a run of many processes, read by libraries that have nothing to do with this project."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from tests.system.helpers import (
    MAIN_TOPICS,
    BagMessage,
    Finished,
    bag_digest,
    bag_file,
    bag_messages,
    swarm,
)

from swarmabs_config.scenario import parse_scenario
from swarmabs_core.cdr import decode, encode
from swarmabs_core.messages import TOPICS

pytestmark = [pytest.mark.system, pytest.mark.timeout(120)]

STEPS = 300
AGENTS = (1, 2, 3, 4)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Finished]:
    folder = tmp_path_factory.mktemp("bag") / "run"
    return folder, swarm("run", "arise_het_4", "--duration", 3, "-o", folder, "--json")


@pytest.fixture(scope="module")
def run_folder(finished: tuple[Path, Finished]) -> Path:
    folder, done = finished
    assert done.code == 0, done.err
    return folder


@pytest.fixture(scope="module")
def messages(run_folder: Path) -> list[BagMessage]:
    return bag_messages(run_folder)


def test_the_folder_holds_what_the_contract_says(run_folder: Path) -> None:
    assert {path.name for path in run_folder.iterdir()} == {"bag", "logs", "scenario.yaml", "summary.json"}
    assert {path.name for path in (run_folder / "bag").iterdir()} == {"bag_0.mcap", "metadata.yaml"}
    assert (run_folder / "logs" / "launcher.log").read_bytes() == b""


def test_no_file_of_the_tracing_library_remains(tmp_path: Path) -> None:
    """Neither those that the run's nodes make nor those that somebody left whom nobody needs any more."""
    memory = Path("/dev/shm")
    mapped = Path("/proc/self/maps").read_text(encoding="utf-8")
    left = {path.name for path in memory.glob("lttng-ust-wait-*") if path.name not in mapped}
    assert swarm("run", "pd_het_4", "--duration", 0.1, "--no-bag", "-o", tmp_path / "run").code == 0
    now = {path.name for path in memory.glob("lttng-ust-wait-*") if path.name not in mapped}
    assert not now - left


def test_every_message_is_there_exactly_once(messages: list[BagMessage]) -> None:
    found = Counter((m.topic, m.step, m.agent_id) for m in messages if m.topic in MAIN_TOPICS)
    expected = {
        (topic, step, agent)
        for topic in MAIN_TOPICS
        for step in range(STEPS + 1)
        for agent in (AGENTS if topic == "swarm/agent_state" else (0,))
    }
    assert set(found) == expected
    assert set(found.values()) == {1}


def test_times_are_those_of_the_steps(messages: list[BagMessage]) -> None:
    for message in messages:
        assert message.stamp == message.log_time == message.publish_time == message.step * 10_000_000


def test_within_a_step_the_order_is_that_of_the_contract(messages: list[BagMessage]) -> None:
    order = [
        *("swarm/agent_state", "plane/state", "swarm/abstract_state"),
        *("swarm/auxiliary_state", "swarm/desired_abstract_state", "swarm/events"),
    ]
    keys = [(m.step, order.index(m.topic), m.agent_id if m.topic != "swarm/events" else 0) for m in messages]
    assert keys == sorted(keys)


def test_bytes_are_canonical(messages: list[BagMessage]) -> None:
    types = {topic.name: topic.message for topic in TOPICS}
    for message in messages:
        assert message.payload[:4] == b"\0\1\0\0"
        assert encode(decode(types[message.topic], message.payload)) == message.payload


def test_digest_and_count_are_those_of_the_summary(finished: tuple[Path, Finished], messages: list[BagMessage]) -> None:
    summary = finished[1].summary()
    assert summary["digest"] == bag_digest(messages)
    assert summary["messages"] == len(messages)


def test_rosbags_reads_the_numbers_that_the_summary_names(run_folder: Path, finished: tuple[Path, Finished]) -> None:
    largest, last_angle, counts = 0.0, 0.0, Counter[str]()
    with AnyReader([run_folder / "bag"]) as reader:
        for connection, time, data in reader.messages():
            message: Any = reader.deserialize(data, connection.msgtype)
            counts[connection.topic] += 1
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
            assert message.header.frame_id == "plane"
            if connection.topic == "/swarm/agent_state":
                largest = max(largest, abs(message.position))
            elif connection.topic == "/plane/state":
                last_angle = message.angle
    summary = finished[1].summary()
    assert counts["/swarm/agent_state"] == 4 * (STEPS + 1)
    assert largest == summary["max_abs_position"]
    reference = 0.7 * __import__("math").sin(0.0471238898038469 * 3.0)
    assert reference - last_angle == pytest.approx(summary["final_error"], abs=1e-9)


def test_the_bag_says_where_it_comes_from_and_can_run_again(run_folder: Path) -> None:
    with bag_file(run_folder).open("rb") as stream:
        attached = {attachment.name: attachment.data for attachment in make_reader(stream).iter_attachments()}
    scenario = attached["scenario.yaml"].decode()
    assert scenario == (run_folder / "scenario.yaml").read_text(encoding="utf-8")
    assert parse_scenario(scenario).steps == STEPS
    provenance = json.loads(attached["provenance.json"])
    assert provenance["driver"] == "lockstep"
    assert provenance["libm_fingerprint"]
    log = attached["run.log"].decode()
    assert all(name in log for name in ("orchestrator.log", "plane_sim.log", "agent_004.log"))


def test_metadata_is_that_of_ros(run_folder: Path, messages: list[BagMessage]) -> None:
    metadata = yaml.safe_load((run_folder / "bag" / "metadata.yaml").read_text(encoding="utf-8"))
    information = metadata["rosbag2_bagfile_information"]
    assert information["storage_identifier"] == "mcap"
    assert information["message_count"] == len(messages)
    assert information["duration"]["nanoseconds"] == 3_000_000_000


def test_info_agrees(run_folder: Path, messages: list[BagMessage]) -> None:
    done = swarm("info", run_folder, "--json")
    assert done.code == 0, done.err
    assert str(len(messages)) in done.out


def test_without_a_bag_the_figures_are_the_same(tmp_path: Path, finished: tuple[Path, Finished]) -> None:
    done = swarm("run", "arise_het_4", "--duration", 3, "--no-bag", "-o", tmp_path / "run", "--json")
    assert done.code == 0, done.err
    assert not (tmp_path / "run" / "bag").exists()
    same = ("digest", "messages", "final_error", "rms_error", "max_abs_position", "settled_at")
    assert {key: done.summary()[key] for key in same} == {key: finished[1].summary()[key] for key in same}
