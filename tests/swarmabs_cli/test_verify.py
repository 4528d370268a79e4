"""``swarm verify``, as a user types it; bags are changed by the mcap library, which is another writer than ours."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer
from tests.swarmabs_analysis.figures.conftest import record

from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.writer import BAG_FILE
from swarmabs_cli import main
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulation import simulated_steps

pytestmark = pytest.mark.timeout(60)
FAULTS = "faults=[{at: 0.1, kind: kill, agent: 2}, {kind: loss, probability: 0.2}]"

Change = Callable[[str, int, bytes], bytes | None]
"""Topic, number of the message on it, and bytes in; the bytes that shall stand there out, None to leave them out."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run with faults, which is not to be changed."""
    return record(tmp_path_factory.mktemp("runs") / "run", "pd_het_4", FAULTS)


def verify(capfd: pytest.CaptureFixture[str], *words: object, code: int) -> Any:
    """Run the command and return the one JSON document that it printed."""
    assert main(["verify", *map(str, words), "--json"]) == code
    return json.loads(capfd.readouterr().out, parse_constant=pytest.fail)


def refused(capfd: pytest.CaptureFixture[str], *words: object) -> str:
    """Run the command, which refuses, and return its one line."""
    assert main(["verify", *map(str, words), "--json"]) == 2
    captured = capfd.readouterr()
    assert captured.out == "" and captured.err.startswith("error: ") and captured.err.count("\n") == 1
    return captured.err


def rewritten(
    run: Path,
    target: Path,
    change: Change = lambda _topic, _number, data: data,
    attachments: Mapping[str, bytes | None] = {},
    published: Callable[[str, int], int] = lambda _topic, _number: 0,
    more: Mapping[str, bytes] = {},
    **options: Any,
) -> Path:
    """Write a bag's messages and attachments to a new file, some changed, None for left out, or published later, ns."""
    with (run / "bag" / BAG_FILE).open("rb") as source, target.open("wb") as sink:
        reader, writer = make_reader(source), Writer(sink, **options)
        writer.start(profile="ros2", library="another")
        kept = {attachment.name: attachment.data for attachment in reader.iter_attachments()}
        for name, data in (*{**kept, **attachments}.items(), *more.items()):
            if data is not None:
                writer.add_attachment(0, 0, name, "text/plain", data)
        channels: dict[str, int] = {}
        numbers: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            number = numbers[channel.topic] = numbers.get(channel.topic, -1) + 1
            data = change(channel.topic, number, message.data)
            if data is None:
                continue
            if channel.topic not in channels:
                made = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(
                    channel.topic, channel.message_encoding, made, dict(channel.metadata)
                )
            time = message.publish_time + published(channel.topic, number)
            writer.add_message(channels[channel.topic], message.log_time, data, time)
        writer.finish()
    return target


def flipped(data: bytes, bit: int) -> bytes:
    changed = bytearray(data)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def last_command(topic: str, number: int, data: bytes) -> bytes:
    """Change the lowest bit of the command, which is the last field, of robot 3 in step 7 of four robots."""
    return flipped(data, 8 * (len(data) - 8)) if (topic, number) == ("/swarm/agent_state", 4 * 7 + 2) else data


@pytest.mark.parametrize("named", ["", "bag", f"bag/{BAG_FILE}"])
def test_a_right_bag_is_right(capfd: pytest.CaptureFixture[str], run: Path, named: str) -> None:
    with (run / "bag" / BAG_FILE).open("rb") as stream:
        count = sum(1 for _ in make_reader(stream).iter_messages())
    found = verify(capfd, run / named, code=0)
    assert (found["ok"], found["first_difference"], found["problem"]) == (True, None, None)
    assert (found["complete"], found["steps"], found["expected_steps"]) == (True, 31, 31)
    assert found["messages"] == count
    assert main(["simulate", "--set", FAULTS, "--duration", "0.3", "--json", "-o", "again"]) == 0
    assert found["digest"] == json.loads(capfd.readouterr().out)["digest"]
    assert verify(capfd, "again", code=0)["digest"] == found["digest"]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_bag_of_another_writer_is_right_and_one_bit_in_it_is_named(
    capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path
) -> None:
    assert verify(capfd, rewritten(run, tmp_path / "copy.mcap"), code=0)["ok"]
    changed = rewritten(run, tmp_path / "changed.mcap", last_command)
    found = verify(capfd, changed, code=1)
    difference = found["first_difference"]
    assert [difference[key] for key in ("topic", "step", "agent", "field")] == ["swarm/agent_state", 7, 3, "command"]
    recorded, recomputed = (struct.pack("<d", difference[key]) for key in ("recorded", "recomputed"))
    assert int.from_bytes(recorded, "little") ^ int.from_bytes(recomputed, "little") == 1
    assert (found["ok"], found["complete"], found["digest"], found["steps"]) == (False, False, None, 7)
    assert main(["verify", str(changed)]) == 1
    shown = capfd.readouterr().out
    assert "NOT ok" in shown
    assert f"/swarm/agent_state, step 7, robot 3: command is {difference['recorded']!r}, recomputed" in shown
    assert verify(capfd, changed, "--tolerance", "1e-12", code=0)["tolerance"] == 1e-12


def test_a_bag_with_two_scenarios_is_refused(capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path) -> None:
    """Of what is it a run? Whoever reads the first attachment and who reads the last would not agree."""
    text = (run / "scenario.yaml").read_bytes()
    same = rewritten(run, tmp_path / "same.mcap", more={"scenario.yaml": text})
    assert verify(capfd, same, code=0)["ok"]
    other = str(rewritten(run, tmp_path / "other.mcap", more={"scenario.yaml": text + b"# another\n"}))
    for words in (
        ["verify", other],
        ["replay", other, "--node", "plane", "-o", "again", "--in-process"],
        ["report", other],
        ["simulate", other, "-o", "again"],
        ["check", other],
        ["markers", other, "-o", "again"],
        ["scenario", "show", other],
    ):
        assert main(words) == 2, words
        assert "other.mcap holds several scenarios and does not say of which it is a run" in capfd.readouterr().err
    assert main(["info", other]) == 1
    assert "several scenarios" in " ".join(capfd.readouterr().out.split())
    assert not Path("again").exists()


@pytest.mark.parametrize("command", ["verify", "info"])
def test_a_bag_of_a_writer_that_does_not_index_attachments(
    capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path, command: str
) -> None:
    bare = rewritten(run, tmp_path / "bare.mcap", index_types=IndexType.NONE)
    with bare.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.attachment_indexes == [] and summary.statistics.attachment_count == 2
    assert main([command, str(bare), "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    found = found[0] if isinstance(found, list) else found
    assert "pd_het_4" in str(found["scenario"])


@pytest.mark.parametrize("provenance", [None, b"{", b"[]"])
def test_a_bag_that_does_not_say_how_it_was_made_is_verified_with_a_note(
    capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path, provenance: bytes | None
) -> None:
    bare = rewritten(run, tmp_path / "bare.mcap", attachments={"provenance.json": provenance})
    (note,) = verify(capfd, bare, code=0)["notes"]
    assert "no provenance.json that can be read" in note and "taken for a run in lockstep" in note


def test_a_file_of_a_split_bag_that_is_missing_is_named(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["simulate", "--duration", "4", "--max-bag-duration", "1", "-o", "split"]) == 0
    capfd.readouterr()
    (tmp_path / "split" / "bag" / "bag_1.mcap").unlink()
    found = verify(capfd, "split", code=1)
    assert "bag_1.mcap is missing" in found["problem"]
    assert (found["first_difference"]["step"], found["first_difference"]["field"]) == (100, "message")


def test_several_bags_give_a_list_and_one_wrong_one_decides(
    capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path
) -> None:
    found = verify(capfd, run, rewritten(run, tmp_path / "changed.mcap", last_command), code=1)
    assert [one["ok"] for one in found] == [True, False]


def test_the_summary_beside_the_bag_must_have_its_digest(
    capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path
) -> None:
    (tmp_path / "moved" / "bag").mkdir(parents=True)
    rewritten(run, tmp_path / "moved" / "bag" / BAG_FILE)
    summary = tmp_path / "moved" / "summary.json"
    for text, recorded in (('{"digest": "00"}', "00"), ("{", None)):
        summary.write_text(text)
        difference = verify(capfd, tmp_path / "moved", code=1)["first_difference"]
        assert (difference["topic"], difference["field"], difference["recorded"]) == (
            "summary.json",
            "digest",
            recorded,
        )


def test_the_time_of_publication_counts(capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path) -> None:
    late = rewritten(
        run, tmp_path / "late.mcap", published=lambda topic, number: topic == "/plane/state" and number == 7
    )
    difference = verify(capfd, late, code=1)["first_difference"]
    assert (difference["topic"], difference["step"], difference["field"]) == ("plane/state", 7, "publish_time")
    assert (difference["recorded"], difference["recomputed"]) == (70_000_001, 70_000_000)


def test_another_library_explains_a_difference(capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path) -> None:
    elsewhere = {"provenance.json": b'{"libm_fingerprint": "0123", "versions": {"python": "2.7"}}'}
    assert verify(capfd, rewritten(run, tmp_path / "same.mcap", attachments=elsewhere), code=0)["notes"] == []
    notes = verify(capfd, rewritten(run, tmp_path / "other.mcap", last_command, elsewhere), code=1)["notes"]
    assert "fingerprint 0123" in notes[0] and "--tolerance" in notes[0]
    assert notes[1].startswith("the bag was recorded with python 2.7, here 3.")


def test_an_interrupted_run_is_verified_as_far_as_it_goes(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    scenario = find_scenario("pd_het_4", ["duration=0.3"]).resolved()
    recording = Recording(scenario, tmp_path / "bag", driver="simulate")
    for step in simulated_steps(scenario):
        if step.step == 20:
            break
        recording.add(step)
    recording.abort("interrupted")
    found = verify(capfd, tmp_path / "bag", code=0)
    assert (found["ok"], found["complete"], found["steps"], found["expected_steps"]) == (True, False, 20, 31)
    assert found["ended_early"] == "interrupted"
    assert main(["verify", str(tmp_path / "bag")]) == 0
    assert "the run ended early: interrupted" in capfd.readouterr().out


def test_a_damaged_bag_is_verified_up_to_there_and_is_not_right(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run = record(tmp_path / "long", "pd_het_4", "duration=60")
    data = (run / "bag" / BAG_FILE).read_bytes()
    cut, changed = tmp_path / "cut.mcap", tmp_path / "changed.mcap"
    cut.write_bytes(data[: len(data) * 2 // 3])
    changed.write_bytes(flipped(data, 8 * (len(data) * 2 // 3)))
    for bag in (cut, changed):
        found = verify(capfd, bag, code=1)
        assert (found["ok"], found["first_difference"], found["digest"]) == (False, None, None)
        assert found["problem"] and 0 < found["steps"] < 6001
        assert found["messages"] >= 8 * found["steps"]


def test_a_recording_that_was_killed_is_right_once_it_is_repaired(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data = (record(tmp_path / "long", "pd_het_4", "duration=60") / "bag" / BAG_FILE).read_bytes()
    within = 0
    for part in (4, 5, 6):
        run = tmp_path / str(part)
        (run / "bag").mkdir(parents=True)
        (run / "bag" / BAG_FILE).write_bytes(data[: len(data) * part // 8])
        assert main(["repair", str(run), "--in-place"]) == 0
        capfd.readouterr()
        found = verify(capfd, run, code=0)
        assert (found["complete"], found["ended_early"]) == (False, "the recording was cut off")
        assert 8 * found["steps"] <= found["messages"] < 8 * (found["steps"] + 1)
        within += found["messages"] > 8 * found["steps"]
        unsaid = verify(capfd, rewritten(run, run / "unsaid.mcap"), code=1)["first_difference"]
        assert (unsaid["step"], unsaid["field"]) == (found["steps"], "message")
    assert within


@pytest.mark.parametrize("length", [4, 100])
def test_a_bag_of_which_nothing_is_left_is_damaged_and_not_refused(
    capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path, length: int
) -> None:
    stump = tmp_path / "stump.mcap"
    stump.write_bytes((run / "bag" / BAG_FILE).read_bytes()[:length])
    found = verify(capfd, stump, code=1)
    assert (found["ok"], found["first_difference"], found["steps"]) == (False, None, 0)
    assert "stump.mcap" in found["problem"]
    assert main(["verify", str(stump)]) == 1
    assert "damaged: " in capfd.readouterr().out


def test_what_cannot_be_verified_is_refused(capfd: pytest.CaptureFixture[str], run: Path, tmp_path: Path) -> None:
    def with_attachment(name: str, data: bytes | None) -> Path:
        return rewritten(run, tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap", attachments={name: data})

    assert "holds no scenario" in refused(capfd, with_attachment("scenario.yaml", None))
    assert re.search(
        r"scenario\.yaml:2: .*plne", refused(capfd, with_attachment("scenario.yaml", b"schema: 1\nplne: 1"))
    )
    assert "is not UTF-8 text" in refused(capfd, with_attachment("scenario.yaml", b"\xff"))
    for driver, said in (("gazebo", "recorded by driver 'gazebo'"), ("realtime", "does not say how time became steps")):
        provenance = f'{{"driver": "{driver}"}}'.encode()
        assert said in refused(capfd, with_attachment("provenance.json", provenance))
    assert len(refused(capfd, with_attachment("provenance.json", b'{"driver": "' + b"x" * 9999 + b'"}'))) < 500
    plane_only = rewritten(run, tmp_path / "plane.mcap", lambda topic, _, data: data if "plane" in topic else None)
    assert "it has no topic swarm/agent_state" in refused(capfd, plane_only)
    assert "is not a bag" in refused(capfd, Path(__file__))
    assert "nowhere" in refused(capfd, tmp_path / "nowhere")
