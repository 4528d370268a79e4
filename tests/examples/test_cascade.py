"""The example of a cascade of two layers, against a continuous-time solution, a linear analysis and its records."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from cascade import main, simulate_cascade
from layers import FOLDER, CascadeSimulation, Coupling, load_cascade
from tests.docs.pages import read
from tests.examples import cascade_margins
from tests.examples.cascade_oracle import solve

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.info import bag_info
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from swarmabs_core.arrays import RunArrays

pytestmark = pytest.mark.timeout(60)

LOWER = ("lower_1", "lower_2", "lower_3")
NO_COULOMB = "plane.friction=[0.0, 1000, 700, 0.0, 1000, 1.0]"


def upper_angle(bandwidth: float, *overrides: str, folder: Path = FOLDER) -> np.ndarray:
    """Angle of the upper plane at every step, as far as the run goes."""
    steps = CascadeSimulation(load_cascade(folder, Coupling(bandwidth=bandwidth), overrides)).steps()
    return np.array([step.plane.angle for namespace, step in steps if namespace == "/upper"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of the program as the page starts it."""
    path = tmp_path_factory.mktemp("cascade") / "run"
    assert main(["-o", str(path)]) == 0
    return path


@pytest.fixture(scope="module")
def runs(folder: Path) -> dict[str, RunArrays]:
    """Every layer's run, from its bag."""
    return {name: load_arrays(folder / name, namespace=f"/{name}") for name in ("upper", *LOWER)}


def test_upper_plane_is_level_after_ten_seconds(runs: dict[str, RunArrays]) -> None:
    upper = runs["upper"]
    assert upper.angle[0] == 0.1
    assert np.abs(upper.angle[upper.time >= 10.0]).max() < 0.02


def test_every_layer_has_a_complete_bag_and_a_summary(folder: Path) -> None:
    for name in ("upper", *LOWER):
        info = bag_info(folder / name)
        assert info.problem is None
        assert info.namespace == f"/{name}/"
        summary = json.loads((folder / name / "summary.json").read_text(encoding="utf-8"))
        assert (summary["status"], summary["steps"]) == ("ok", 2000)


def test_upper_robots_move_as_their_lower_planes_are_tilted(runs: dict[str, RunArrays]) -> None:
    upper = runs["upper"]
    for column, name in enumerate(LOWER):
        angle, rate = runs[name].angle, runs[name].angular_velocity
        np.testing.assert_allclose(upper.agents.velocity[:, column], angle, rtol=1e-15)
        # Simpson's rule is exact for the cubic between two steps.
        middle = 0.5 * (angle[:-1] + angle[1:]) + 0.01 / 8.0 * (rate[:-1] - rate[1:])
        moved = 0.01 / 6.0 * (angle[:-1] + 4.0 * middle + angle[1:])
        np.testing.assert_allclose(np.diff(upper.agents.position[:, column]), moved, atol=1e-15)


def test_continuous_cascade_agrees(runs: dict[str, RunArrays]) -> None:
    time = np.arange(1201) * 0.01
    solution = solve(FOLDER, 1.0, 15.0, time)
    upper = np.abs(runs["upper"].angle[:1201] - solution.upper)
    lower = np.abs(np.transpose([runs[name].angle[:1201] for name in LOWER]) - solution.lower)
    places = np.abs(runs["upper"].agents.position[:1201] - solution.position)
    assert upper.max() < 6e-3
    assert lower.max() < 1e-2
    assert places.max() < 3e-3
    assert upper[500:].max() < 1e-3
    assert lower[500:].max() < 1e-4


def test_difference_to_the_continuous_cascade_is_that_of_sampling(tmp_path: Path) -> None:
    """With lower swarms that start where the idealised ones do, in balance, it halves with the period."""
    for path in FOLDER.glob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        balanced = re.sub(r"mass: [0-9.]+", "mass: 0.4", text) if path.stem in LOWER else text
        (tmp_path / path.name).write_text(balanced, encoding="utf-8")
    solution = solve(tmp_path, 1.0, 15.0, np.arange(401) * 0.01)
    coarse, fine = (
        np.abs(
            upper_angle(15.0, "duration=4.0", f"step={step}", folder=tmp_path)[:: round(0.01 / step)] - solution.upper
        )
        for step in (0.01, 0.005)
    )
    assert coarse.max() < 3e-3
    assert 1.6 < coarse.max() / fine.max() < 2.4


@pytest.mark.parametrize(("bandwidth", "level"), [(4.0, False), (7.0, True), (20.0, True), (30.0, False)])
def test_lower_layer_must_be_neither_too_slow_nor_too_fast(bandwidth: float, level: bool) -> None:  # noqa: FBT001
    after_ten_seconds = np.abs(upper_angle(bandwidth, "duration=13.0")[1000:]).max()
    assert bool(after_ten_seconds < 0.02) is level
    assert level or after_ten_seconds > 0.2


@pytest.mark.parametrize(("bandwidth", "decays"), [(8.0, True), (6.0, False)])
def test_bound_of_the_bandwidth_is_that_of_the_linear_analysis(bandwidth: float, decays: bool) -> None:  # noqa: FBT001
    _, _, gain_margin = cascade_margins.margins(cascade_margins.loops(1.0, 1.0, bandwidth)["upper plane"])
    assert (gain_margin > 1.0) is decays
    angle = np.abs(upper_angle(bandwidth, "duration=16.0", NO_COULOMB))
    assert bool(angle[1200:].max() < angle[400:800].max() / 2) is decays


def test_margins_of_the_page() -> None:
    rows = re.findall(
        r"^\| (\w+ \w+) \| (\d+|-) \| (\d+) \| ([\d.]+) \| (\d+) \| ([\d.]+) \|$", read("docs/cascade.md"), re.MULTILINE
    )
    assert len(rows) == 8
    for loop, upper_slope, lower_slope, *stated in rows:
        response = cascade_margins.loops(float(upper_slope.replace("-", "1")), float(lower_slope), 15.0)[loop]
        for text, value in zip(stated, cascade_margins.margins(response), strict=True):
            half = 0.51 * 10.0 ** -len(text.partition(".")[2])
            assert abs(float(text) - value) <= half, (loop, upper_slope, lower_slope)


def test_failed_cascade_leaves_whole_bags_and_names_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "slow"
    assert main(["-o", str(path), "--bandwidth", "3"]) == 1
    assert re.match(r"error: step \d+: the plane's angle is -?1\.5", capsys.readouterr().err)
    for name in ("upper", *LOWER):
        assert json.loads((path / name / "summary.json").read_text(encoding="utf-8"))["status"] == "failed"
        assert len(load_arrays(path / name).step) > 1000


def test_layers_that_do_not_fit_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in FOLDER.glob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        (tmp_path / path.name).write_text(text.replace("duration: 20.0", f"duration: {len(path.stem)}.0"), "utf-8")
    with pytest.raises(InputError, match="/lower_1: step and duration must be those of /upper"):
        load_cascade(tmp_path)
    assert main(["-o", str(tmp_path / "out"), "--bandwidth", "0"]) == 2
    assert "bandwidth is 0.0; give a positive number" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.system
@pytest.mark.timeout(150)
def test_processes_over_dds_leave_the_same_digests(nothing_survives: str, tmp_path: Path) -> None:
    assert main(["-o", str(tmp_path / "processes"), "--processes", "--set", "duration=0.5"]) == 0
    cascade = load_cascade(overrides=["duration=0.5"])
    simulated = simulate_cascade(cascade, new_run_folder(tmp_path / "simulated"))
    for name in ("upper", *LOWER):
        summary = json.loads((tmp_path / "processes" / name / "summary.json").read_text(encoding="utf-8"))
        assert summary["digest"] == simulated[f"/{name}"]["digest"]
