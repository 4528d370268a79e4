"""A bag of two swarms, made by the mcap library: every command that reads a swarm reads the one that is named."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_bag.writer import BAG_FILE
from swarmabs_cli import main

pytestmark = pytest.mark.timeout(60)

STEP, AGENT = 7, 3


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("runs") / "run", "pd_het_4")


def merged(run: Path, target: Path, *scenarios: bytes) -> Path:
    """Write a run as two swarms, /east, and /west in which one bit of the command of a robot is another."""
    with (run / "bag" / BAG_FILE).open("rb") as source, target.open("wb") as sink:
        reader, writer = make_reader(source), Writer(sink)
        writer.start(profile="ros2", library="another")
        for attachment in reader.iter_attachments():
            for data in (scenarios or (attachment.data,)) if attachment.name == "scenario.yaml" else (attachment.data,):
                writer.add_attachment(0, 0, attachment.name, "text/plain", data)
        channels: dict[str, int] = {}
        states = 0
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            data = bytearray(message.data)
            if channel.topic == "/swarm/agent_state":
                if states == 4 * STEP + AGENT - 1:
                    data[-8] ^= 1
                states += 1
            for name, payload in (("/east", message.data), ("/west", bytes(data))):
                topic = name + channel.topic
                if topic not in channels:
                    made = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[topic] = writer.register_channel(topic, "cdr", made, dict(channel.metadata))
                writer.add_message(channels[topic], message.log_time, payload, message.publish_time)
        writer.finish()
    return target


@pytest.fixture(scope="module")
def bag(run: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(merged(run, tmp_path_factory.mktemp("merged") / "two.mcap"))


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def document(capfd: pytest.CaptureFixture[str], *words: str, code: int = 0) -> Any:
    assert main([*words, "--json"]) == code
    return json.loads(capfd.readouterr().out, parse_constant=pytest.fail)


def place(difference: dict[str, Any]) -> list[Any]:
    return [difference[name] for name in ("topic", "step", "agent", "field")]


CHANGED = ["swarm/agent_state", STEP, AGENT, "command"]


def test_verify(capfd: pytest.CaptureFixture[str], bag: str, run: Path) -> None:
    east = document(capfd, "verify", bag, "--namespace", "/east")
    assert east["complete"]
    assert east["digest"] == document(capfd, "verify", str(run))["digest"]
    west = document(capfd, "verify", bag, "--namespace", "west", code=1)
    assert place(west["first_difference"]) == CHANGED


def test_compare_two_swarms_of_one_bag(capfd: pytest.CaptureFixture[str], bag: str, run: Path) -> None:
    found = document(capfd, "compare", bag, bag, "--namespace", "/east", "--namespace", "/west", code=1)
    assert place(found["first_difference"]) == CHANGED
    assert "/west/plane/state" in found["a"]["not_compared"]
    assert "/east/plane/state" in found["b"]["not_compared"]
    assert document(capfd, "compare", bag, bag, "--namespace", "/west")["equal"]
    assert main(["compare", bag, bag, *(["--namespace", "/west"] * 3)]) == 2
    assert main(["compare", bag, str(run), "--namespace", "/east", "--namespace", "/"]) == 0


def test_export(bag: str, run: Path, here: Path) -> None:
    for name in ("east", "west"):
        assert main(["export", bag, "-o", name, "--namespace", name]) == 0
        assert main(["export", bag, "-o", f"{name}.npz", "--format", "numpy", "--namespace", name]) == 0
    assert main(["export", str(run), "-o", "run"]) == 0
    tables = {name: (here / name / "agents.csv").read_text() for name in ("east", "west", "run")}
    assert tables["east"] == tables["run"]
    rows = [list(csv.reader(tables[name].splitlines())) for name in ("east", "west")]
    assert [line for line, (a, b) in enumerate(zip(*rows, strict=True)) if a != b] == [4 * STEP + AGENT]
    with np.load("east.npz") as east, np.load("west.npz") as west:
        differ = np.argwhere(east["agents_command"] != west["agents_command"])
    assert differ.tolist() == [[STEP, AGENT - 1]]


def test_replay_of_a_node_gives_a_bag_of_that_swarm(capfd: pytest.CaptureFixture[str], bag: str, here: Path) -> None:
    words = ("replay", bag, "--node", f"agent:{AGENT}", "--in-process")
    assert document(capfd, *words, "--namespace", "/east", "--expect-same", "-o", "new")["replay"]["same"]
    with (here / "new" / "bag" / BAG_FILE).open("rb") as stream:
        assert {channel.topic.split("/")[1] for _, channel, _ in make_reader(stream).iter_messages()} == {"east"}
    found = document(capfd, *words, "--namespace", "/west", "-o", "other")["replay"]
    assert place(found["first_difference"]) == CHANGED


def test_report(capfd: pytest.CaptureFixture[str], bag: str) -> None:
    east, west = (document(capfd, "report", bag, "-o", name, "--namespace", name) for name in ("east", "west"))
    assert east["digest"] != west["digest"]
    assert document(capfd, "verify", bag, "--namespace", "/east")["digest"] == east["digest"]


def test_info_says_which_swarms_there_are(capfd: pytest.CaptureFixture[str], bag: str) -> None:
    found = document(capfd, "info", bag)
    assert (found["namespace"], found["swarms"]) == (None, ["/east/", "/west/"])
    assert main(["info", bag]) == 0
    assert re.search(r"^swarms in +/east, /west *$", capfd.readouterr().out, re.MULTILINE)


@pytest.mark.parametrize(
    "words",
    [
        ("verify",),
        ("compare", "{bag}"),
        ("export", "-o", "new"),
        ("export", "-o", "new.npz", "--format", "numpy"),
        ("replay", "--node", "plane", "--in-process", "-o", "new"),
        ("report", "-o", "new"),
    ],
)
def test_none_or_a_wrong_name_is_refused_with_those_that_there_are(
    capfd: pytest.CaptureFixture[str], bag: str, here: Path, words: tuple[str, ...]
) -> None:
    command = [words[0], bag, *(word.format(bag=bag) for word in words[1:])]
    for more, text in (
        ([], "holds several swarms: choose one with --namespace: /east, /west"),
        (["--namespace", "/north\x1b"], r"holds no swarm in the namespace /north\x1b, but in /east, /west"),
    ):
        assert main([*command, *more]) == 2
        error = capfd.readouterr().err
        assert text in error
        assert error.count("\n") == 1
    assert not list(here.iterdir())


def test_of_different_scenarios_none_is_taken_for_that_of_a_swarm(
    capfd: pytest.CaptureFixture[str], run: Path, here: Path
) -> None:
    scenario = (run / "scenario.yaml").read_bytes()
    assert main(["verify", str(merged(run, here / "a.mcap", scenario, scenario)), "--namespace", "/east"]) == 0
    two = merged(run, here / "b.mcap", scenario, scenario.replace(b"duration: 0.3", b"duration: 0.4"))
    capfd.readouterr()
    assert main(["verify", str(two), "--namespace", "/east"]) == 2
    assert "holds several scenarios and does not say which of its swarms each is of" in capfd.readouterr().err


@pytest.mark.parametrize("command", ["run", "simulate"])
def test_a_run_is_of_one_swarm(capfd: pytest.CaptureFixture[str], bag: str, here: Path, command: str) -> None:
    assert main([command, bag]) == 2
    assert "holds several swarms, and a run is of one; run the scenario.yaml" in capfd.readouterr().err
    assert not list(here.iterdir())
    assert document(capfd, "scenario", "show", bag)["name"] == "pd_het_4"
