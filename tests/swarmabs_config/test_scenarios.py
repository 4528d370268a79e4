"""The built-in scenarios, and how a scenario is named."""

import math
import os
import re
import subprocess
import sys
from math import inf
from pathlib import Path

import pytest
from tests.processes import ROOT

from swarmabs_bag.attached import scenario_of
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.model.controllers import AriseConfig, PdConfig
from swarmabs_config.scenario import Scenario, dump_scenario, load_scenario
from swarmabs_config.scenarios import DEFAULT, builtin_scenarios, find_scenario
from swarmabs_core.errors import InputError
from swarmabs_run.simulated_run import simulate_run

MASSES = (0.3552, 0.3532, 0.6762, 0.4596)
DAMPINGS = (0.7290, 1.4133, 0.6524, 1.3258)
SINGLES = {"si": 4, "di": 0, "het": 2}


@pytest.fixture(scope="module")
def built_in() -> dict[str, Scenario]:
    return {name: load_scenario(path) for name, path in builtin_scenarios().items()}


def test_the_papers_eight_runs_are_built_in(built_in: dict[str, Scenario]) -> None:
    assert {name: (each.controller.type, len(each.agents), each.duration) for name, each in built_in.items()} == {
        **{f"pd_{kind}_4": ("pd", 4, 30.0) for kind in SINGLES},
        **{f"arise_{kind}_4": ("arise", 4, 70.0) for kind in SINGLES},
        "arise_het_20": ("arise", 20, 70.0),
        "arise_het_200": ("arise", 200, 40.0),
    }
    for name, scenario in built_in.items():
        assert find_scenario(name) == scenario
        assert (scenario.name, scenario.step, scenario.plane.substep) == (name, 0.01, inf)
        disturbance = scenario.plane.disturbance
        if name.startswith("pd"):
            assert scenario.controller == PdConfig(gains=(3.1623, 3.2859))
            assert (scenario.plane.angle, disturbance.amplitude) == (0.1, 0.0)
        else:
            assert scenario.controller == AriseConfig()
            assert (scenario.plane.angle, disturbance.amplitude, disturbance.angular_frequency) == (0.075, 0.1, 0.5)


@pytest.mark.parametrize(("swarm", "singles"), SINGLES.items())
def test_four_robots(built_in: dict[str, Scenario], swarm: str, singles: int) -> None:
    for parent in ("pd", "arise"):
        agents = built_in[f"{parent}_{swarm}_4"].agents
        assert [agent.id for agent in agents] == [1, 2, 3, 4]
        assert tuple(agent.mass for agent in agents) == MASSES
        assert [agent.position for agent in agents] == [0.125, -0.125, 0.125, -0.125]
        assert all(agent.velocity == 0.0 for agent in agents)
        kinds = ["single_integrator"] * singles + ["double_integrator"] * (4 - singles)
        assert [agent.kind for agent in agents] == kinds
        assert tuple(agent.damping for agent in agents) == (0.0,) * singles + DAMPINGS[singles:]


@pytest.mark.parametrize(("count", "inertia"), [(20, 0.15), (200, 0.0288)])
def test_larger_swarms(built_in: dict[str, Scenario], count: int, inertia: float) -> None:
    agents = built_in[f"arise_het_{count}"].agents
    assert [agent.kind for agent in agents].count("single_integrator") == count // 2
    assert math.fsum(agent.mass * agent.position**2 for agent in agents) == pytest.approx(inertia, rel=0.1)
    assert [math.copysign(1, agent.position) for agent in agents] == [1, -1] * (count // 2)


def test_a_path_finds_a_file_and_builtin_names_precede_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "mine.yaml"
    builtin = builtin_scenarios()["pd_si_4"].read_text(encoding="utf-8")
    file.write_text(builtin.replace("name: pd_si_4", ""), encoding="utf-8")
    assert find_scenario(str(file)).name == "mine"
    (tmp_path / "pd_het_4").mkdir()
    monkeypatch.chdir(tmp_path)
    found = find_scenario(DEFAULT, ["duration=2", "plane.angle=0.2"])
    assert (DEFAULT, found.name, found.plane.angle) == ("pd_het_4", "pd_het_4", 0.2)


def test_a_bag_brings_its_own_scenario(tmp_path: Path) -> None:
    scenario = find_scenario("pd_het_4", ["duration=0.1", "plane.angle=0.05"]).resolved()
    simulate_run(scenario, new_run_folder(tmp_path / "run"))
    for way in ("", "bag", "bag/bag_0.mcap"):
        assert dump_scenario(scenario_of(str(tmp_path / "run" / way))) == dump_scenario(scenario)
        assert scenario_of(str(tmp_path / "run" / way), ["duration=0.2"]).steps == 20
    with pytest.raises(InputError, match="bag"):
        scenario_of(str(tmp_path))


def test_what_is_not_there_is_refused_with_a_hint() -> None:
    hints = {"pd_het4": "did you mean pd_het_4?", "nothing at all": "arise_di_4, "}
    for named, words in {**hints, "no/such.yaml": "no/such.yaml", "gone.yaml": "gone.yaml"}.items():
        with pytest.raises(InputError, match=rf"^.*{re.escape(words)}.*$"):
            find_scenario(named)


def test_scenarios_are_found_in_the_sources_where_nothing_is_installed() -> None:
    sources = ROOT / "src"
    paths = os.pathsep.join(str(sources / name) for name in ("swarmabs_config", "swarmabs_core"))
    code = "from swarmabs_config.scenarios import builtin_folder; print(builtin_folder())"
    environment = {**os.environ, "AMENT_PREFIX_PATH": "/nowhere", "PYTHONPATH": paths}
    found = subprocess.check_output([sys.executable, "-c", code], env=environment, text=True)
    assert found.strip() == str(sources / "swarmabs_bringup" / "scenarios")
