"""The commands for bags of a run in which each robot coordinates the swarm by itself."""

from pathlib import Path

import pytest
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_cli.conftest import document, ran, refused

from swarmabs_bag.run.writer import BAG_FILE

COORDINATION = ("coordination=each_robot", "links={type: ring, loss: 0.5}")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run, which is not to be changed."""
    return record(tmp_path_factory.mktemp("runs") / "run", "pd_het_4", "duration=1", *COORDINATION)


def test_a_bag_is_verified_compared_exported_and_run_again(run: Path, tmp_path: Path) -> None:
    info = document("info", run)
    relays = [topic for topic in info["topics"] if topic["name"].endswith("/relay")]
    assert [topic["name"] for topic in relays] == [f"/agent_{robot:03d}/relay" for robot in range(1, 5)]
    found = document("verify", run)
    assert (found["complete"], found["notes"], found["messages"]) == (True, [], info["message_count"])
    assert sum(topic["message_count"] for topic in relays) == found["messages"] - 8 * 101
    central = record(tmp_path / "central", "pd_het_4", "duration=1")
    assert document("compare", run, central)["equal"]
    ran("export", run, "-o", tmp_path / "tables")
    again = document("simulate", run, "-o", tmp_path / "again")
    assert (again["rerun_of"]["same"], again["digest"]) == (True, found["digest"])


@pytest.mark.system
def test_a_cut_off_bag_is_repaired_and_merged_with_another(run: Path, tmp_path: Path) -> None:
    whole = (run / "bag" / BAG_FILE).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 4])
    repaired = document("repair", cut, "-o", tmp_path / "repaired")
    last = {topic["name"]: topic["last_complete_step"] for topic in repaired["topics"] if "relay" in topic["name"]}
    assert len(last) == 4
    assert min(last.values()) >= repaired["last_complete_step"] > 0
    found = document("verify", tmp_path / "repaired")
    assert (found["ok"], found["complete"]) == (True, False)
    assert found["steps"] == repaired["last_complete_step"] + 1
    merged = document("repair", "--merge", run, tmp_path / "repaired", "-o", tmp_path / "merged")
    assert (merged["gaps"], merged["messages"]) == ([], document("info", run)["message_count"])
    assert document("verify", tmp_path / "merged")["complete"]


def test_an_option_is_short_for_the_setting(run: Path, tmp_path: Path) -> None:
    links = "links={type: ring, loss: 0.5}"
    asked = ("--coordination", "each_robot", "--duration", "1", "--set", links)
    short = document("simulate", "pd_het_4", *asked, "-o", tmp_path / "short")
    assert (tmp_path / "short" / "scenario.yaml").read_bytes() == (run / "scenario.yaml").read_bytes()
    assert short["digest"] == document("verify", run)["digest"]
    assert "--coordination" in refused("simulate", "pd_het_4", "--coordination", "nobody")


def test_no_node_is_tested_in_a_playback(run: Path) -> None:
    said = refused("replay", run, "--node", "agent:1")
    assert "each robot of this run coordinates the swarm by itself" in said
