"""The study of the rig in MuJoCo: its tables say what the trials show, and the printed laws are those of the paper."""

import csv
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest
from tests.errata import paper
from tests.swarmabs_core.helpers import builtin

from swarmabs_core.swarm_law import LAWS

DURATION = 3.0


@pytest.fixture
def example(mujoco_example: dict[str, Any]) -> dict[str, Any]:
    """Return the modules of the example by name; their laws are forgotten after the test."""
    LAWS.forget()
    return mujoco_example


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.system
def test_tables_contain_what_the_trials_show(
    example: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Two seeds, one map with two cells, and the trial's own program as the oracle."""
    study, maps, trial = example["study"], example["study_maps"], example["mujoco_trial"]
    delay = replace(maps.MAPS["delay"], values=(0, 30), loops=(maps.PD,))
    monkeypatch.setattr(study, "MAPS", {"delay": delay})
    monkeypatch.setattr(study, "BY_SEED", {maps.ARISE: 100, maps.PRINTED: 1})
    monkeypatch.setattr(study, "SCENARIOS", (4,))
    asked = ["--seeds", "2", "--duration", f"{DURATION}", "--workers", "1", "-o", str(tmp_path)]
    assert study.main(asked) == 0

    overrides = [f"duration={DURATION}", "plane.angle=0.1", "plane.disturbance.amplitude=0", "controller={type: pd}"]
    scenario = builtin("arise_het_4", *overrides)
    cells = rows_of(tmp_path / "maps.csv")
    assert [float(cell["value"]) for cell in cells] == [0.0, 30.0]
    for cell, seconds in zip(cells, (0.0, 0.03), strict=True):
        setup = replace(maps.CALIBRATED, faults=replace(maps.CALIBRATED.faults, delay=seconds))
        results = [trial.run(scenario, setup, seed) for seed in (1, 2)]
        assert (cell["robots"], cell["loop"], cell["trials"]) == ("4", "PD", "2")
        assert int(cell["settled"]) == sum(result.settled for result in results)
        assert float(cell["median_error"]) == median(result.error for result in results)
        assert float(cell["largest_error"]) == max(result.error for result in results)
        assert float(cell["farthest"]) == max(result.farthest for result in results)
        assert float(cell["steepest"]) == max(result.steepest for result in results)

    summary = {(row["robots"], row["loop"]): row for row in rows_of(tmp_path / "seeds.csv")}
    results = [trial.run(builtin("arise_het_4", f"duration={DURATION}"), maps.SEEDED, seed) for seed in (1, 2)]
    assert float(summary["4", "ARISE, reference"]["largest_error"]) == max(result.error for result in results)
    printed = summary["4", "ARISE as printed"]
    assert (printed["settled"], printed["largest_error"]) == ("0", "inf")
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "reality_maps.png",
        "reality_printed.png",
        "reality_seeds.png",
    }

    # Trials that the folder has are not repeated.
    monkeypatch.setattr(study, "run", None)
    before = (tmp_path / "trials.csv").read_bytes()
    assert study.main([*asked, "--map", "delay"]) == 0
    assert (tmp_path / "trials.csv").read_bytes() == before


def test_spread_is_that_of_equal_masses_on_both_sides(example: dict[str, Any]) -> None:
    """sqrt(S3)/S0 of equal masses is the standard deviation of their positions."""
    scenario = builtin("pd_het_4", *(f"swarm.agents.{robot}.mass=0.5" for robot in range(4)))
    places = (0.2, -0.1, 0.05, -0.3)
    state = example["virtual_swarm"].State(0.0, 0.0, 0.0, places)
    assert example["study_trials"].spread(scenario, state) == pytest.approx(np.std(places))


@pytest.mark.parametrize("seed", range(3))
def test_printed_laws_have_the_errors_of_the_paper(example: dict[str, Any], seed: int) -> None:
    laws = example["printed_laws"]
    swarm = paper.random_swarm(seed, double=True)
    rows = [laws.printed_row(m, p, swarm.sums()) for m, p in zip(swarm.m, swarm.p, strict=True)]
    np.testing.assert_allclose(swarm.phi @ rows, np.diag([paper.GRAVITY, 1.0]), atol=1e-8)

    s0, s1, s2, _ = swarm.s()
    md, p = swarm.m * (paper.UNEVEN.ksd + swarm.c), swarm.p
    matrix = [
        [md @ (s2 - p * s1), 0.5 * md @ (p * s0 - s1)],
        [2.0 * (md * p) @ (s2 - p * s1), (md * p) @ (p * s0 - s1)],
    ]
    np.testing.assert_allclose(np.reshape(laws.printed_damping(swarm.sums()), (2, 2)), matrix, rtol=1e-8, atol=1e-8)
