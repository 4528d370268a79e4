"""Two bags: what is said of each, against numpy on arrays; and what is not whole or not alike."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from tests.swarmabs_bag.sample_run import AGENTS, changed, make_run, write_bag

from swarmabs_analysis.comparison.bags import SettingDifference, compare_bags, setting_differences
from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.errors import NotABagError
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_cli import main
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.messages import PlaneState
from swarmabs_run.simulated_run import simulate_run


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the folders of four simulated runs: twice the same, one with other angle, one with other period."""
    folder = tmp_path_factory.mktemp("runs")
    settings = {
        "one": ["duration=2"],
        "same": ["duration=2"],
        "other": ["duration=1.5", "plane.angle=0.2", "faults=[{at: 0.5, kind: leave, agent: 2}]"],
        "period": ["duration=2", "step=0.02"],
    }
    for name, overrides in settings.items():
        simulate_run(find_scenario("pd_het_4", overrides).resolved(), new_run_folder(folder / name))
    return {name: folder / name for name in settings}


def test_the_same_scenario_twice_is_equal(runs: dict[str, Path]) -> None:
    found = compare_bags(runs["one"], runs["same"] / "bag")
    assert found.equal
    assert found.a.digest == found.b.digest
    assert (found.scenario, found.provenance) == ((), ())


def test_figures_are_those_of_the_messages(runs: dict[str, Path]) -> None:
    (runs["other"] / "summary.json").unlink(missing_ok=True)
    found = compare_bags(runs["one"], runs["other"])
    for side, path in ((found.a, runs["one"]), (found.b, runs["other"])):
        arrays = load_arrays(path)
        assert side.figures["rms_error"] == pytest.approx(np.sqrt(np.mean(arrays.angle**2)))
        assert side.figures["final_error"] == -arrays.angle[-1]
        assert side.figures["max_abs_position"] == np.nanmax(np.abs(arrays.agents.position))
        assert side.figures["settled_at"] is None
        assert (side.first_step, side.last_step) == (arrays.step[0], arrays.step[-1])


def test_deviations_are_those_of_the_arrays(runs: dict[str, Path]) -> None:
    found = compare_bags(runs["one"], runs["other"])
    apart = np.abs(load_arrays(runs["one"]).angle[:151] - load_arrays(runs["other"]).angle)
    plane = next(topic for topic in found.messages.topics if topic.topic == "plane/state")
    angle = plane.fields[0]
    assert (plane.compared, plane.missing_in_a, plane.missing_in_b) == (151, 0, 50)
    assert (angle.largest, angle.step) == (apart.max(), apart.argmax())
    assert angle.rms == pytest.approx(np.sqrt(np.mean(apart**2)))


def test_differences_of_the_scenarios_are_named_as_set_takes_them(runs: dict[str, Path]) -> None:
    assert compare_bags(runs["one"], runs["other"]).scenario == (
        SettingDifference("duration", 2.0, 1.5),
        SettingDifference("plane.angle", 0.1, 0.2),
        SettingDifference("faults.0.kind", None, "leave", "A"),
        SettingDifference("faults.0.at", None, 0.5, "A"),
        SettingDifference("faults.0.agent", None, 2, "A"),
    )


def test_other_periods_are_compared_step_by_step(runs: dict[str, Path]) -> None:
    found = compare_bags(runs["one"], runs["period"])
    assert (found.a.period, found.b.period) == (0.01, 0.02)
    plane = next(topic for topic in found.messages.topics if topic.topic == "plane/state")
    assert (plane.compared, plane.missing_in_b) == (101, 100)
    assert [field.field for field in plane.fields] == ["stamp", "angle", "angular_velocity"]


def test_other_robots_are_named(tmp_path: Path) -> None:
    a = write_bag(tmp_path / "a", make_run(agents=AGENTS[:2]))
    found = compare_bags(a, write_bag(tmp_path / "b", make_run()))
    assert (found.robots_only_in_a, found.robots_only_in_b) == ((), (7,))
    assert (found.a.robots, found.b.robots) == (2, 3)


def test_provenance_is_compared_by_field(tmp_path: Path) -> None:
    bags = [
        write_bag(tmp_path / name, make_run(), {"provenance.json": json.dumps(document).encode()})
        for name, document in {"a": {"versions": {"x": "1"}, "m": 1}, "b": {"versions": {"x": "2"}, "m": 1}}.items()
    ]
    found = compare_bags(*bags)
    assert found.equal
    assert found.provenance == (SettingDifference("versions.x", "1", "2"),)
    assert "holds no scenario" in (found.a.scenario_problem or "")
    assert found.a.figures["rms_error"] is None


def test_a_bag_that_is_cut_off_is_compared_as_far_as_it_goes(runs: dict[str, Path], tmp_path: Path) -> None:
    whole = next((runs["one"] / "bag").glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    found = compare_bags(runs["one"], cut)
    assert not found.equal
    assert found.damaged
    assert str(cut) in (found.b.problem or "")
    assert all(topic.differing == topic.missing_in_a == 0 for topic in found.messages.topics)


@pytest.mark.parametrize("place", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_a_flipped_bit_anywhere_is_no_equality(tmp_path: Path, place: float) -> None:
    a = write_bag(tmp_path / "a", make_run(), {"provenance.json": b"{}"})
    b = next(write_bag(tmp_path / "b", make_run(), {"provenance.json": b"{}"}).glob("*.mcap"))
    data = bytearray(b.read_bytes())
    data[int(len(data) * place)] ^= 1
    b.write_bytes(data)
    found = compare_bags(a, b)
    assert found.damaged
    assert not found.equal


def test_what_is_no_bag_of_a_swarm_is_refused(tmp_path: Path, runs: dict[str, Path]) -> None:
    with pytest.raises(NotABagError, match="cannot read"):
        compare_bags(runs["one"], tmp_path / "nothing")


def test_lists_are_taken_apart_only_if_they_hold_mappings() -> None:
    a = {"gains": [1, 2], "agents": [{"id": 1}, {"id": 2}], "limits": None, "none": []}
    b = {"gains": [1, 3], "agents": [{"id": 1}], "limits": 0.5}
    assert setting_differences(a, b) == (
        SettingDifference("gains", [1, 2], [1, 3]),
        SettingDifference("agents.1.id", 2, None, "B"),
        SettingDifference("limits", None, 0.5),
    )


def test_the_command_gives_exit_codes_and_one_document(
    runs: dict[str, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    nan = changed(run := make_run(), next(m for m in run if isinstance(m, PlaneState)), angle=float("nan"))
    bags = [str(write_bag(tmp_path / name, messages)) for name, messages in (("a", run), ("b", nan))]
    for words, code in (
        ([str(runs["one"]), str(runs["same"])], 0),
        (bags, 1),
        ([bags[0], str(tmp_path)], 2),
    ):
        assert main(["compare", *words]) == code
    capfd.readouterr()
    assert main(["compare", *bags, "--json"]) == 1
    document = json.loads(capfd.readouterr().out, parse_constant=pytest.fail)
    assert document["equal"] is False
    assert document["first_difference"]["b"] == "nan"
    assert main(["compare", *bags]) == 1
    assert "first /plane/state step 0: angle is 1.4142135623730951 in A, nan in B" in capfd.readouterr().out
