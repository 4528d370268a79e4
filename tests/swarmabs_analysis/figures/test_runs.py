"""Runs are found where the user points to, and made whole or not at all."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from tests.swarmabs_analysis.figures.conftest import NAMES, record

from swarmabs_analysis.figures.runs import find_made, find_runs, make_run
from swarmabs_bag.errors import NotABagError
from swarmabs_bag.run_folder import RunFolder
from swarmabs_bag.writer import BagWriter
from swarmabs_config.scenario import Scenario, dump_scenario
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError, RunError, SwarmabsError
from swarmabs_core.messages import MAIN_TOPICS
from swarmabs_run.run import Outcome, RunOptions
from swarmabs_run.simulated_run import simulate_run


@pytest.mark.parametrize("part", ["pd_si_4", "pd_si_4/bag", "pd_si_4/bag/bag_0.mcap"])
def test_a_run_is_named_in_three_ways(short_runs: Path, part: str) -> None:
    found = find_runs([short_runs / part], NAMES)
    assert found.keys() == {"pd_si_4"}
    assert found["pd_si_4"].bag == short_runs / "pd_si_4" / "bag" / "bag_0.mcap"
    assert found["pd_si_4"].altered  # it is shorter than the paper's
    assert len(found["pd_si_4"].load().arrays.time) == 31


def test_a_folder_of_runs_is_searched_by_what_the_bags_say(short_runs: Path, tmp_path: Path) -> None:
    shutil.copytree(short_runs / "arise_het_20", tmp_path / "any_name")
    shutil.copy(short_runs / "pd_di_4" / "bag" / "bag_0.mcap", tmp_path / "loose.mcap")
    shutil.copytree(short_runs / "pd_si_4", tmp_path / ".hidden")
    (tmp_path / "notes.txt").write_text("no bag")
    assert find_runs([tmp_path], NAMES).keys() == {"arise_het_20", "pd_di_4"}
    assert find_runs([tmp_path], ["pd_di_4"]).keys() == {"pd_di_4"}
    assert find_runs([short_runs], NAMES).keys() == set(NAMES)


def test_a_bag_that_is_named_twice_is_one(short_runs: Path) -> None:
    assert len(find_runs([short_runs / "pd_si_4", short_runs], ["pd_si_4"])) == 1


def test_two_bags_of_a_scenario_are_refused(short_runs: Path, tmp_path: Path) -> None:
    shutil.copytree(short_runs / "pd_si_4", tmp_path / "pd_si_4-002")
    with pytest.raises(InputError, match=r"pd_si_4/bag.* and .*pd_si_4-002/bag.* are both of pd_si_4; name one"):
        find_runs([short_runs, tmp_path], NAMES)


def test_a_bag_of_no_use_is_left_out_among_others_and_refused_alone(short_runs: Path, tmp_path: Path) -> None:
    whole = (short_runs / "pd_si_4" / "bag" / "bag_0.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    with BagWriter(tmp_path / "foreign", topics=MAIN_TOPICS, attachments={}):
        pass
    scenario = dump_scenario(find_scenario("pd_di_4").resolved()).encode()
    with BagWriter(tmp_path / "empty", topics=MAIN_TOPICS, attachments={"scenario.yaml": scenario}):
        pass
    (tmp_path / "stub.mcap").write_bytes(whole[:3])
    (tmp_path / "whole.mcap").write_bytes(whole)
    reasons: list[str] = []
    assert find_runs([tmp_path], NAMES, reasons.append)["pd_si_4"].bag == tmp_path / "whole.mcap"
    expected = (
        "cut.mcap is not complete: ",
        "bag_0.mcap is not complete: 0 of 3001 states",
        "holds no scenario",
        "3 byt",
    )
    assert [text in reason for text, reason in zip(expected, reasons, strict=True)] == [True] * 4
    for name, text in zip(("cut.mcap", "empty", "foreign", "stub.mcap"), expected, strict=True):
        with pytest.raises(SwarmabsError, match=re.escape(text)):
            find_runs([tmp_path / name], NAMES)


def test_why_a_run_ended_stays_in_its_line(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", topics=MAIN_TOPICS, attachments={}) as writer:
        writer.abort("\n\x1b[2J" * 9999)
    with pytest.raises(InputError, match="is not complete: ") as error:
        find_runs([tmp_path / "bag"], NAMES)
    assert str(error.value).isprintable() and len(str(error.value)) < 3000


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotABagError, match="holds neither a bag nor folders of runs"):
        find_runs([tmp_path], NAMES)
    with pytest.raises(NotABagError, match=r"cannot read .*nothing"):
        find_runs([tmp_path / "nothing"], NAMES)


def test_a_run_that_was_made_is_found_again(tmp_path: Path) -> None:
    assert find_made(tmp_path, ["pd_si_4"]) == {}
    made = make_run(find_scenario("pd_si_4"), tmp_path, simulate_run, RunOptions())
    assert {path.name for path in (tmp_path / "pd_si_4").iterdir()} == {"bag", "logs", "scenario.yaml", "summary.json"}
    assert [path.name for path in tmp_path.iterdir()] == ["pd_si_4"]
    assert find_made(tmp_path, ["pd_si_4", "pd_di_4"]) == {"pd_si_4": made}
    assert not made.altered


def test_a_variant_or_leftovers_are_not_taken_for_the_papers_run(tmp_path: Path) -> None:
    record(tmp_path / "pd_si_4", "pd_si_4")
    (tmp_path / "pd_di_4").mkdir()
    for name in ("pd_si_4", "pd_di_4"):
        with pytest.raises(InputError, match=rf"{name}.*; remove .*, or name another -o"):
            find_made(tmp_path, [name])


def test_a_failed_run_leaves_nothing_and_can_be_made_again(tmp_path: Path) -> None:
    def failing(scenario: Scenario, folder: RunFolder, options: RunOptions) -> Outcome:
        simulate_run(scenario, folder, options)
        return Outcome("failed", "the plane turns over", {})

    scenario = find_scenario("pd_si_4", ["duration=0.1"])
    with pytest.raises(RunError, match="pd_si_4: the plane turns over"):
        make_run(scenario, tmp_path, failing, RunOptions())
    assert list(tmp_path.iterdir()) == []
    assert make_run(scenario, tmp_path, simulate_run, RunOptions()).bag.exists()
