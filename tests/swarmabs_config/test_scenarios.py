"""The built-in scenarios, and how a scenario is named."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.processes import ROOT

from swarmabs_bag.attached import scenario_of
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenario import dump_scenario, load_scenario
from swarmabs_config.scenarios import DEFAULT, builtin_scenarios, find_scenario
from swarmabs_core.errors import InputError
from swarmabs_run.simulated_run import simulate_run

CONTRACT = {
    **{
        f"{law}_{kind}_4": (law, 4, 30.0 if law == "pd" else 70.0)
        for law in ("pd", "arise")
        for kind in ("si", "di", "het")
    },
    "arise_het_20": ("arise", 20, 70.0),
    "arise_het_200": ("arise", 200, 40.0),
}


def test_the_papers_eight_runs_are_built_in() -> None:
    found = {
        name: (scenario.controller.type, len(scenario.agents), scenario.duration)
        for name, path in builtin_scenarios().items()
        for scenario in [load_scenario(path)]
    }
    assert found == CONTRACT


@pytest.mark.parametrize("name", CONTRACT)
def test_a_builtin_scenario_is_found_by_its_name(name: str) -> None:
    scenario = find_scenario(name)
    assert scenario.name == name
    assert scenario.step == 0.01
    if scenario.controller.type == "arise":
        assert (scenario.plane.disturbance.amplitude, scenario.plane.angle) == (0.1, 0.075)


def test_the_default_is_one_of_them() -> None:
    assert DEFAULT in builtin_scenarios()


def test_overrides_apply() -> None:
    assert find_scenario("pd_het_4", ["duration=2", "plane.angle=0.2"]).plane.angle == 0.2


def test_a_file_is_found_by_its_path(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    builtin = (ROOT / "src/swarmabs_bringup/scenarios/pd_si_4.yaml").read_text(encoding="utf-8")
    file.write_text(builtin.replace("name: pd_si_4", ""), encoding="utf-8")
    assert find_scenario(str(file)).name == "mine"


def test_a_builtin_name_comes_before_a_folder_of_that_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pd_het_4").mkdir()
    monkeypatch.chdir(tmp_path)
    assert find_scenario("pd_het_4").name == "pd_het_4"


@pytest.mark.parametrize("way", ["", "bag", "bag/bag_0.mcap"])
def test_a_bag_brings_its_own_scenario(tmp_path: Path, way: str) -> None:
    scenario = find_scenario("pd_het_4", ["duration=0.1", "plane.angle=0.05"]).resolved()
    simulate_run(scenario, new_run_folder(tmp_path / "run"))
    again = scenario_of(str(tmp_path / "run" / way))
    assert dump_scenario(again) == dump_scenario(scenario)
    assert scenario_of(str(tmp_path / "run" / way), ["duration=0.2"]).steps == 20


@pytest.mark.parametrize(
    ("named", "words"),
    [
        ("pd_het4", "did you mean pd_het_4?"),
        ("nothing at all", "there are arise_di_4, "),
        ("no/such.yaml", "no/such.yaml"),
        ("gone.yaml", "gone.yaml"),
    ],
)
def test_what_is_not_there_is_refused_with_a_hint(named: str, words: str) -> None:
    with pytest.raises(InputError) as refusal:
        find_scenario(named)
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="bag"):
        scenario_of(str(tmp_path))


def test_scenarios_are_found_in_the_sources_where_nothing_is_installed() -> None:
    sources = ROOT / "src"
    paths = os.pathsep.join(str(sources / name) for name in ("swarmabs_config", "swarmabs_core"))
    code = "from swarmabs_config.scenarios import builtin_folder; print(builtin_folder())"
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "AMENT_PREFIX_PATH": "/nowhere", "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.strip() == str(sources / "swarmabs_bringup" / "scenarios")
