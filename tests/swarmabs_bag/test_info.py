"""What `bag_info` says of whole, aborted, damaged and foreign bags."""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import asdict
from pathlib import Path

import pytest
from rich.console import Console

from swarmabs_bag.errors import NotABagError
from swarmabs_bag.info import ScenarioInfo, bag_info, render
from swarmabs_bag.writer import BagWriter
from swarmabs_cli import main
from swarmabs_core.cdr import encode
from swarmabs_core.messages import EVENTS, MAIN_TOPICS, PLANE_STATE, Message, PlaneState


def shown(folder: Path) -> str:
    console = Console(file=io.StringIO(), width=200, color_system=None)
    console.print(render(bag_info(folder)))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def bag_with(folder: Path, attachments: dict[str, bytes]) -> Path:
    with BagWriter(folder, topics=MAIN_TOPICS, attachments=attachments):
        pass
    return folder


def test_complete_bag(bag: Path, run: list[Message]) -> None:
    info = bag_info(bag)
    assert info.complete
    assert info.problem is info.aborted is None
    assert info.file == str(bag / "bag_0.mcap")
    assert info.size == (bag / "bag_0.mcap").stat().st_size
    assert (info.profile, info.compression, info.namespace) == ("ros2", "zstd", "/")
    assert (info.start, info.duration, info.message_count) == (0.0, 0.4, len(run))
    assert info.chunks > 3
    assert info.uncompressed_size > 1000
    assert [topic.name for topic in info.topics] == [f"/{topic.name}" for topic in (*MAIN_TOPICS, EVENTS)]
    assert info.topics[0].qos == "best_effort volatile 10"
    assert info.topics[5].qos == "reliable transient_local 1000"
    assert info.topics[0].type == "swarmabs_msgs/msg/AgentState"
    assert info.topics[0].type_hash.startswith("RIHS01_")
    assert info.scenario == ScenarioInfo("sample", seed=5, agents=3, duration=0.4, step=0.01)
    assert (info.versions, info.fingerprint) == ({"swarmabs": "1.2.3"}, "abc123")
    assert info.attachments["run.log"] == 14


def test_information_is_plain_data(bag: Path) -> None:
    found = json.loads(json.dumps(asdict(bag_info(bag)), allow_nan=False))
    assert found["scenario"] == {"name": "sample", "seed": 5, "agents": 3, "duration": 0.4, "step": 0.01}
    assert found["topics"][1]["message_count"] == 41
    assert found["complete"] is True


def test_table_shows_what_matters(bag: Path) -> None:
    text = shown(bag)
    for part in (
        "complete",
        "sample, seed 5, 3 agents",
        "/swarm/agent_state",
        "123",
        "swarmabs 1.2.3",
        "abc123",
        "0 s to 0.4 s",
    ):
        assert part in text


def test_aborted_bag_says_why(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag", topics=MAIN_TOPICS, attachments={})
    writer.abort(reason="agent 17 is [red]dead[/red]")
    info = bag_info(tmp_path)
    assert info.complete
    assert info.aborted == "agent 17 is [red]dead[/red]"
    assert "agent 17 is [red]dead[/red]" in shown(tmp_path)


def test_cut_off_bag_is_damaged_and_described_as_far_as_it_goes(tmp_path: Path, bag: Path) -> None:
    data = (bag / "bag_0.mcap").read_bytes()
    (tmp_path / "x.mcap").write_bytes(data[:-10])
    info = bag_info(tmp_path)
    assert not info.complete
    assert info.problem is not None
    assert info.message_count == bag_info(bag).message_count
    assert info.scenario is not None
    assert "damaged: " in shown(tmp_path)


def test_flipped_bit_is_damage(tmp_path: Path, bag: Path) -> None:
    file = Path(shutil.copy(bag / "bag_0.mcap", tmp_path))
    data = bytearray(file.read_bytes())
    data[data.index(b"zstd") + 40] ^= 1
    file.write_bytes(data)
    info = bag_info(tmp_path)
    assert not info.complete
    assert info.problem is not None
    assert "the chunk" in info.problem


def test_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotABagError):
        bag_info(tmp_path)


@pytest.mark.parametrize(
    "scenario",
    [
        b"",
        b"\xff\xfe",
        b"schema: 99\n",
        b"!!python/object/apply:os.system ['exit 1']\n",
        b"[" * 5000,
        b"a: &a [x, x]\nb: &b [*a, *a]\n"
        + b"".join(b"%c: &%c [*%c, *%c]\n" % (c + 1, c + 1, c, c) for c in range(98, 121)),
    ],
    ids=["empty", "binary", "newer", "code", "deep", "bomb"],
)
def test_hostile_scenario_is_none(scenario: bytes, tmp_path: Path) -> None:
    assert bag_info(bag_with(tmp_path / "bag", {"scenario.yaml": scenario})).scenario is None


@pytest.mark.parametrize(
    "provenance", [b"", b"[]", b"1", b"\xff", b"[" * 100_000, b'{"versions": [1], "libm_fingerprint": null}']
)
def test_hostile_provenance_says_nothing(provenance: bytes, tmp_path: Path) -> None:
    info = bag_info(bag_with(tmp_path / "bag", {"provenance.json": provenance}))
    assert (info.versions, info.fingerprint) == ({}, None)


def test_names_in_a_bag_cannot_steer_the_terminal(tmp_path: Path) -> None:
    text = shown(bag_with(tmp_path / "bag", {"\x1b[2Jx\nfile  /etc": b"", "[bold]y": b""}))
    assert "\x1b" not in text
    assert "\N{REPLACEMENT CHARACTER}[2Jx\N{REPLACEMENT CHARACTER}file" in text
    assert "[bold]y" in text


def test_channel_without_qos_has_none(tmp_path: Path) -> None:
    from mcap.writer import Writer  # noqa: PLC0415 - a foreign bag, in this test only

    with (tmp_path / "x.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "somebody else")
        for topic, metadata in (
            ("/plane/state", {}),
            ("/b", {"offered_qos_profiles": "[[["}),
            ("/c", {"offered_qos_profiles": "[1]"}),
        ):
            schema = writer.register_schema(PLANE_STATE.ros_type, "ros2msg", b"")
            channel = writer.register_channel(topic, "cdr", schema, metadata)
            writer.add_message(channel, 0, encode(PlaneState(0, 0, 0.0, 0.0)), 0)
        writer.finish()
    info = bag_info(tmp_path)
    assert info.complete
    assert [topic.qos for topic in info.topics] == ["", "", ""]
    assert info.scenario is None


def test_in_a_pipe_each_topic_has_a_line(
    bag: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    assert main(["info", str(bag)]) == 0
    words = [line.split() for line in capfd.readouterr().out.splitlines()]
    (plane,) = [line for line in words if line[:1] == ["/plane/state"]]
    assert (plane[1], plane[2:4], plane[-1]) == ("swarmabs_msgs/msg/PlaneState", ["reliable", "volatile"], "41")
