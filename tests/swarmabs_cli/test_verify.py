"""``swarm verify``, as a user types it; bags are changed by the mcap library, which is another writer than ours."""

import re
import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType
from tests.frozen.command import swarm
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_bag.mcap_files import rewritten as copied
from tests.swarmabs_cli.conftest import document, flipped, last_command, ran, refused, rewritten
from tests.swarmabs_core.helpers import singly

from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run.writer import BAG_FILE
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulation import Simulation

FAULTS = "faults=[{at: 0.1, kind: kill, agent: 2}, {kind: loss, probability: 0.2}]"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run with faults, which is not to be changed."""
    return record(tmp_path_factory.mktemp("runs") / "run", "pd_het_4", FAULTS)


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bag of a run that is long enough for several chunks."""
    return (record(tmp_path_factory.mktemp("runs") / "long", "pd_het_4", "duration=30") / "bag" / BAG_FILE).read_bytes()


def verify(*words: object, code: int) -> Any:
    return document("verify", *words, code=code)


@pytest.mark.parametrize("named", ["", "bag", f"bag/{BAG_FILE}"])
def test_a_right_bag_is_right(run: Path, named: str) -> None:
    with (run / "bag" / BAG_FILE).open("rb") as stream:
        count = sum(1 for _ in make_reader(stream).iter_messages())
    found = verify(run / named, code=0)
    assert (found["ok"], found["first_difference"], found["problem"]) == (True, None, None)
    assert (found["complete"], found["steps"], found["expected_steps"]) == (True, 31, 31)
    assert found["messages"] == count
    assert found["digest"] == document("simulate", "--set", FAULTS, "--duration", "0.3", "--no-bag")["digest"]


def test_a_bag_of_another_writer_is_right_and_one_bit_in_it_is_named(run: Path, tmp_path: Path) -> None:
    assert verify(rewritten(run, tmp_path / "copy.mcap"), code=0)["ok"]
    changed = rewritten(run, tmp_path / "changed.mcap", last_command)
    found = verify(changed, code=1)
    difference = found["first_difference"]
    assert [difference[key] for key in ("topic", "step", "agent", "field")] == ["swarm/agent_state", 7, 3, "command"]
    recorded, recomputed = (struct.pack("<d", difference[key]) for key in ("recorded", "recomputed"))
    assert int.from_bytes(recorded, "little") ^ int.from_bytes(recomputed, "little") == 1
    assert (found["ok"], found["complete"], found["digest"], found["steps"]) == (False, False, None, 7)
    shown = ran("verify", changed, code=1).out
    assert "NOT ok" in shown and "ended early" not in shown
    assert f"/swarm/agent_state, step 7, robot 3: command is {difference['recorded']!r}, recomputed" in shown
    assert verify(changed, "--tolerance", "1e-12", code=0)["tolerance"] == 1e-12
    assert [one["ok"] for one in verify(run, changed, code=1)] == [True, False]  # one wrong one decides


def test_written_files_are_listed_as_json(run: Path, tmp_path: Path) -> None:
    for words in (
        ("export", run, "-o", tmp_path / "run.npz", "--format", "numpy"),
        ("markers", run, "-o", tmp_path / "m"),
    ):
        assert document(*words)["files"] == [str(words[3])]


def test_a_bag_with_two_scenarios_is_refused(run: Path, tmp_path: Path) -> None:
    """Of what is it a run? Whoever reads the first attachment and who reads the last would not agree."""
    text = (run / "scenario.yaml").read_bytes()
    same = rewritten(run, tmp_path / "same.mcap", more={"scenario.yaml": text})
    assert verify(same, code=0)["ok"]
    other = rewritten(run, tmp_path / "other.mcap", more={"scenario.yaml": text + b"# another\n"})
    for words in (
        ["verify", other],
        ["verify", other, "--node", "plane"],
        ["report", other],
        ["simulate", other, "-o", "again"],
        ["check", other],
        ["markers", other, "-o", "again"],
        ["scenario", "show", other],
    ):
        assert "other.mcap contains several scenarios and does not state which one was run" in refused(*words)
    assert "several scenarios" in " ".join(ran("info", other, code=1).out.split())


@pytest.mark.parametrize("command", ["verify", "info"])
def test_a_bag_of_a_writer_that_does_not_index_attachments(run: Path, tmp_path: Path, command: str) -> None:
    bare = rewritten(run, tmp_path / "bare.mcap", index_types=IndexType.NONE)
    with bare.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.attachment_indexes == [] and summary.statistics.attachment_count == 2
    assert "pd_het_4" in str(document(command, bare)["scenario"])


@pytest.mark.parametrize("provenance", [None, b"{", b"[]"])
def test_a_bag_that_does_not_say_how_it_was_made_is_verified_with_a_note(
    run: Path, tmp_path: Path, provenance: bytes | None
) -> None:
    bare = rewritten(run, tmp_path / "bare.mcap", attachments={"provenance.json": provenance})
    (note,) = verify(bare, code=0)["notes"]
    assert "no readable provenance.json" in note and "lockstep is assumed" in note


def test_a_file_of_a_split_bag_that_is_missing_is_named(tmp_path: Path) -> None:
    ran("simulate", "--duration", "4", "--max-bag-duration", "1", "-o", "split")
    (tmp_path / "split" / "bag" / "bag_1.mcap").unlink()
    found = verify("split", code=1)
    assert "bag_1.mcap is missing" in found["problem"]
    assert (found["first_difference"]["step"], found["first_difference"]["field"]) == (100, "message")


def test_the_summary_beside_the_bag_must_have_its_digest(run: Path, tmp_path: Path) -> None:
    (tmp_path / "moved" / "bag").mkdir(parents=True)
    rewritten(run, tmp_path / "moved" / "bag" / BAG_FILE)
    summary = tmp_path / "moved" / "summary.json"
    for text, recorded in (('{"digest": "00"}', "00"), ("{", None)):
        summary.write_text(text)
        difference = verify(tmp_path / "moved", code=1)["first_difference"]
        assert [difference[key] for key in ("topic", "field", "recorded")] == ["summary.json", "digest", recorded]


def test_the_time_of_publication_counts(run: Path, tmp_path: Path) -> None:
    seventh = ("/plane/state", 7)
    late = rewritten(run, tmp_path / "late.mcap", published=lambda topic, number: (topic, number) == seventh)
    difference = verify(late, code=1)["first_difference"]
    assert (difference["topic"], difference["step"], difference["field"]) == ("plane/state", 7, "publish_time")
    assert (difference["recorded"], difference["recomputed"]) == (70_000_001, 70_000_000)


def test_a_bag_that_was_converted_from_sqlite_has_no_publish_times(run: Path, tmp_path: Path) -> None:
    lost = rewritten(run, tmp_path / "lost.mcap", publish_times=False)
    assert verify(lost, code=1)["first_difference"]["field"] == "publish_time", "the recorder writes them"
    nothing = {"provenance.json": None}
    assert verify(rewritten(run, tmp_path / "bare.mcap", attachments=nothing, publish_times=False), code=0)["complete"]


def test_other_versions_explain_a_difference(run: Path, tmp_path: Path) -> None:
    elsewhere = {"provenance.json": b'{"arithmetic": 2, "versions": {"python": "2.7"}}'}
    assert verify(rewritten(run, tmp_path / "same.mcap", attachments=elsewhere), code=0)["notes"] == []
    notes = verify(rewritten(run, tmp_path / "other.mcap", last_command, elsewhere), code=1)["notes"]
    assert notes[0].startswith("the bag was recorded with python 2.7, here 3.")


def test_a_bag_of_the_former_arithmetic_is_compared_within_what_it_differs_by(run: Path, tmp_path: Path) -> None:
    """The frozen bags of that time are verified in test_compatibility.py."""
    former = {"provenance.json": b'{"libm_fingerprint": "0123"}'}
    for by, code in ((1e-11, 0), (1e-7, 1)):

        def moved(topic: str, number: int, data: bytes, by: float = by) -> bytes:
            if (topic, number) != ("/swarm/abstract_state", 20):
                return data
            (rate,) = struct.unpack("<d", data[-8:])
            return data[:-8] + struct.pack("<d", rate + by)

        found = verify(rewritten(run, tmp_path / f"{code}.mcap", moved, former), code=code)
        assert found["tolerance"] == 1e-9
        (note,) = found["notes"]
        assert "the former arithmetic, which versions of 0.1.0 that record no arithmetic" in note
    assert found["first_difference"]["field"] == "inertia_rate"


def test_a_bag_of_a_later_arithmetic_is_refused(run: Path, tmp_path: Path) -> None:
    later = rewritten(run, tmp_path / "later.mcap", attachments={"provenance.json": b'{"arithmetic": 3}'})
    assert "was recorded under arithmetic 3, but this version computes with 2; update" in refused("verify", later)


def test_an_interrupted_run_is_verified_as_far_as_it_goes(tmp_path: Path) -> None:
    scenario = find_scenario("pd_het_4", ["duration=0.3"]).resolved()
    recording = Recording(scenario, tmp_path / "bag", driver="simulate")
    for step in singly(Simulation(scenario).steps())[:20]:
        recording.add(step)
    recording.abort("interrupted")
    found = verify(tmp_path / "bag", code=0)
    assert (found["ok"], found["complete"], found["steps"], found["expected_steps"]) == (True, False, 20, 31)
    assert found["ended_early"] == "interrupted"
    assert "the run ended early: interrupted" in ran("verify", tmp_path / "bag").out


def test_a_damaged_bag_is_verified_up_to_there_and_is_not_right(long: bytes, tmp_path: Path) -> None:
    cut, changed = tmp_path / "cut.mcap", tmp_path / "changed.mcap"
    summary = make_reader(BytesIO(long)).get_summary()
    assert summary is not None
    *_, last = summary.chunk_indexes
    place = last.chunk_start_offset + last.chunk_length // 2
    cut.write_bytes(long[:place])
    changed.write_bytes(flipped(long, 8 * place))
    for bag in (cut, changed):
        found = verify(bag, code=1)
        assert (found["ok"], found["first_difference"], found["digest"]) == (False, None, None)
        assert found["problem"] and 0 < found["steps"] < 3001
        assert found["messages"] >= 8 * found["steps"]


def test_a_recording_that_was_killed_is_right_once_it_is_repaired(long: bytes, tmp_path: Path) -> None:
    within = 0
    for part in (4, 6):
        run = tmp_path / str(part)
        (run / "bag").mkdir(parents=True)
        (run / "bag" / BAG_FILE).write_bytes(long[: len(long) * part // 8])
        ran("repair", run, "--in-place")
        found = verify(run, code=0)
        assert (found["complete"], found["ended_early"]) == (False, "the recording was cut off")
        assert 8 * found["steps"] <= found["messages"] < 8 * (found["steps"] + 1)
        within += found["messages"] > 8 * found["steps"]
        unsaid = verify(rewritten(run, run / "unsaid.mcap"), code=1)["first_difference"]
        assert (unsaid["step"], unsaid["field"]) == (found["steps"], "message")
    assert within


@pytest.mark.parametrize("length", [4, 100])
def test_a_bag_of_which_nothing_is_left_is_damaged_and_not_refused(run: Path, tmp_path: Path, length: int) -> None:
    stump = tmp_path / "stump.mcap"
    stump.write_bytes((run / "bag" / BAG_FILE).read_bytes()[:length])
    found = verify(stump, code=1)
    assert (found["ok"], found["first_difference"], found["steps"]) == (False, None, 0)
    assert "stump.mcap" in found["problem"]
    assert "damaged: " in ran("verify", stump, code=1).out


def test_what_cannot_be_verified_is_refused(run: Path, tmp_path: Path) -> None:
    def with_attachment(name: str, data: bytes | None) -> Path:
        return rewritten(run, tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap", attachments={name: data})

    assert "contains no scenario" in refused("verify", with_attachment("scenario.yaml", None))
    assert re.search(
        r"scenario\.yaml:2: .*plne", refused("verify", with_attachment("scenario.yaml", b"schema: 1\nplne: 1"))
    )
    assert "is not UTF-8 text" in refused("verify", with_attachment("scenario.yaml", b"\xff"))
    for driver, said in (("gazebo", "recorded by driver 'gazebo'"), ("realtime", "lacks a valid entry realtime")):
        provenance = f'{{"driver": "{driver}"}}'.encode()
        assert said in refused("verify", with_attachment("provenance.json", provenance))
    assert len(refused("verify", with_attachment("provenance.json", b'{"driver": "' + b"x" * 9999 + b'"}'))) < 500
    plane_only = rewritten(run, tmp_path / "plane.mcap", lambda topic, _, data: data if "plane" in topic else None)
    assert "it lacks swarm/agent_state" in refused("verify", plane_only)
    assert "is not a bag" in refused("verify", Path(__file__))
    assert "nowhere" in refused("verify", tmp_path / "nowhere")


@pytest.mark.system
def test_a_bag_without_a_scenario_is_verified_and_reported_with_a_named_one(tmp_path: Path) -> None:
    assert swarm(("simulate", "--duration", "0.3", "-o", tmp_path / "run"), tmp_path).code == 0
    bare = copied(tmp_path / "run" / "bag", tmp_path / "bare.mcap", attachments=False)
    given = ("--scenario", tmp_path / "run" / "scenario.yaml")
    refused = swarm(("verify", bare), tmp_path)
    assert (refused.code, "contains no scenario" in refused.err) == (2, True)
    assert swarm(("verify", bare, *given), tmp_path).code == 0
    assert swarm(("report", bare, *given, "--html", tmp_path / "x.html"), tmp_path).code == 0
    assert "leave out --scenario" in swarm(("verify", tmp_path / "run", *given), tmp_path).err
