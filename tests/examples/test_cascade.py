"""The example of a cascade of two layers, against a continuous-time solution, a linear analysis and its records."""

import json
import re
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
import yaml
from cascade import main, simulate_cascade
from layers import FOLDER, CascadeSimulation, Coupling, load_cascade
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tests.docs.pages import read

from swarmabs_bag.arrays import load_arrays
from swarmabs_bag.info import bag_info
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_core.arrays import RunArrays
from swarmabs_core.errors import InputError

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


# The defaults of docs/reference/scenario.md, and the command filter of docs/explanation/equations.md.
GRAVITY, INERTIA, CURVATURE, OFFSET, FILTER = 9.81, 0.5, 0.0125, 0.025, 50.0
PERIOD = 0.01
UPPER_GAINS, LOWER_GAINS, SWARM_GAIN = (2.0, 1.0), (30.0, 6.0), 1.5
LOWER = ("lower_1", "lower_2", "lower_3")
FREQUENCIES = np.logspace(-2.5, 2.5, 1001)


def plane_response(s: Complex, slope: float) -> Complex:
    return 1.0 / ((INERTIA + OFFSET) * s**2 + slope * s)


def torque_response(s: Complex) -> Complex:
    """The command filter, and the command that is held for a period."""
    return (FILTER / (s + FILTER)) ** 2 * np.exp(-0.5 * PERIOD * s)


def lower_response(s: Complex, slope: float) -> Complex:
    return (LOWER_GAINS[0] + LOWER_GAINS[1] * s) * torque_response(s) * plane_response(s, slope)


def drive_response(s: Complex, slope: float, bandwidth: float) -> Complex:
    """From the command of an upper robot to its speed: G."""
    loop = lower_response(s, slope)
    following = (loop + torque_response(s)) / (1.0 + loop)
    return np.exp(-1.5 * PERIOD * s) * (bandwidth / (s + bandwidth)) ** 3 * following


def loops(upper_slope: float, lower_slope: float, bandwidth: float) -> dict[str, Complex]:
    """Return the frequency responses of the opened loops of docs/explanation/cascade.md, linearised."""
    s = 1j * FREQUENCIES
    drive = drive_response(s, lower_slope, bandwidth)
    swarm = (s + SWARM_GAIN) * drive / (s + SWARM_GAIN * drive)
    law = UPPER_GAINS[0] + UPPER_GAINS[1] * s
    return {
        "lower plane": lower_response(s, lower_slope),
        "upper swarm": SWARM_GAIN * drive / s,
        "upper plane": law * torque_response(s) * swarm * plane_response(s, upper_slope),
    }


def margins(response: Complex) -> tuple[float, float, float]:
    """Return crossover (rad/s), phase margin (degrees) and gain margin."""
    gain, phase, _, _, crossover, _ = control.stability_margins(control.frd(response, FREQUENCIES))
    return float(crossover), float(phase), float(gain)


def friction(w: Any) -> Any:
    return 0.01 * (np.tanh(1000.0 * w) - np.tanh(700.0 * w)) + 0.02 * np.tanh(1000.0 * w) + w


def solve(bandwidth: float, time: Array) -> tuple[Array, Array, Array]:
    """Solve the example at times in s: angles of the upper plane (n,), of the lower ones, and upper positions (n, N).

    It is written from docs/explanation/cascade.md and the equations alone, and shares with the example the numbers of
    the scenario files only. It is idealised: no sampling and no delay of a period; every lower swarm exerts at once the
    torque and inertia that its controller asks for after the command filter.
    """

    above, *below = (
        yaml.safe_load((FOLDER / f"{name}.yaml").read_text(encoding="utf-8")) for name in ("upper", *LOWER)
    )
    robots = above["swarm"]["agents"]
    n = len(robots)
    mass = np.array([robot["mass"] for robot in robots])
    k1, k2 = above["controller"]["gains"]
    gain, fastest = np.array(above["swarm"]["gains"]["k"]), above["limits"]["velocity"]
    lower_gains = np.array([scenario["controller"]["gains"] for scenario in below])
    tilts = np.array([scenario["plane"]["angle"] for scenario in below])
    angle = above["plane"]["angle"]

    def rates(_: float, state: Array) -> Array:
        th, w, tau, dtau = state[:4]
        p, s, r, dr, x, dx, a, v = state[4:].reshape(8, n)
        # The robots' law, with the pseudo-inverse of the matrix that maps velocities to rates of the abstract state.
        phi = np.vstack([GRAVITY * mass, 2.0 * mass * p])
        wanted = np.array([tau, CURVATURE * tau**2 + OFFSET])
        there = np.array([GRAVITY * mass @ p, mass @ p**2])
        ahead = np.array([dtau, 2.0 * CURVATURE * tau * dtau])
        u = np.clip(np.linalg.pinv(phi) @ (gain * (wanted - there) + ahead), -fastest, fastest)
        # The reference of every lower plane: three equal lags.
        ds = bandwidth * (u - s)
        ddr = bandwidth**2 * (s - r) - 2.0 * bandwidth * dr
        raw = lower_gains[:, 0] * (a - r) + lower_gains[:, 1] * (v - dr)
        raw -= ((INERTIA + OFFSET) * ddr + friction(dr)) / np.cos(a)
        ddx = FILTER**2 * (np.clip(raw, -5.0, 5.0) - x) - 2.0 * FILTER * dx
        dv = (-np.cos(a) * x - 2.0 * CURVATURE * x * dx * v - friction(v)) / (INERTIA + CURVATURE * x**2 + OFFSET)
        # The upper plane under its robots, which move as the lower planes are tilted.
        dp = a
        dw = (-np.cos(th) * there[0] - 2.0 * (mass * p) @ dp * w - friction(w)) / (INERTIA + there[1])
        ddtau = FILTER**2 * (np.clip(k1 * th + k2 * w, -5.0, 5.0) - tau) - 2.0 * FILTER * dtau
        return np.concatenate([[w, dw, dtau, ddtau], dp, ds, dr, ddr, dx, ddx, v, dv])

    zero = np.zeros(n)
    places = np.array([robot["position"] for robot in robots])
    initial = np.concatenate([[angle, 0.0, k1 * angle, 0.0], places, tilts, tilts, zero, zero, zero, tilts, zero])
    found = solve_ivp(rates, (time[0], time[-1]), initial, method="LSODA", t_eval=time, rtol=1e-7, atol=1e-9)
    assert found.success, found.message
    planes = found.y[4:].reshape(8, n, -1)
    return found.y[0], planes[6].T, planes[0].T


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of the program as the page starts it, but for the duration."""
    path = tmp_path_factory.mktemp("cascade") / "run"
    assert main(["-o", str(path), "--set", "duration=11.0"]) == 0
    return path


@pytest.fixture(scope="module")
def runs(folder: Path) -> dict[str, RunArrays]:
    return {name: load_arrays(folder / name, namespace=f"/{name}") for name in ("upper", *LOWER)}


@pytest.mark.system
def test_every_layer_has_a_bag_and_lower_planes_move_upper_robots(folder: Path, runs: dict[str, RunArrays]) -> None:
    for name in ("upper", *LOWER):
        info = bag_info(folder / name)
        assert info.problem is None
        assert info.namespace == f"/{name}/"
        summary = json.loads((folder / name / "summary.json").read_text(encoding="utf-8"))
        assert (summary["status"], summary["steps"]) == ("ok", 1100)
    upper = runs["upper"]
    for column, name in enumerate(LOWER):
        angle, rate = runs[name].angle, runs[name].angular_velocity
        np.testing.assert_allclose(upper.agents.velocity[:, column], angle, rtol=1e-15)
        # Simpson's rule is exact for the cubic between two steps.
        middle = 0.5 * (angle[:-1] + angle[1:]) + 0.01 / 8.0 * (rate[:-1] - rate[1:])
        moved = 0.01 / 6.0 * (angle[:-1] + 4.0 * middle + angle[1:])
        np.testing.assert_allclose(np.diff(upper.agents.position[:, column]), moved, atol=1e-15)


@pytest.mark.system
def test_continuous_cascade_agrees(runs: dict[str, RunArrays]) -> None:
    solved = solve(15.0, np.arange(1001) * 0.01)
    angles = runs["upper"].angle, np.transpose([runs[name].angle for name in LOWER])
    upper, lower, places = (
        np.abs(found[:1001] - given)
        for found, given in zip((*angles, runs["upper"].agents.position), solved, strict=True)
    )
    assert (upper.max() < 6e-3, lower.max() < 1e-2, places.max() < 3e-3) == (True, True, True)
    assert upper[500:].max() < 1e-3
    assert np.abs(runs["upper"].angle[1000:]).max() < 0.02
    assert lower[500:].max() < 1e-4


@pytest.mark.parametrize(("bandwidth", "level"), [(4.0, False), (20.0, True), (30.0, False)])
@pytest.mark.system
def test_lower_layer_must_be_neither_too_slow_nor_too_fast(bandwidth: float, level: bool) -> None:  # noqa: FBT001
    steps = CascadeSimulation(load_cascade(FOLDER, Coupling(bandwidth=bandwidth), ["duration=7.0"])).steps()
    angles = [plane.angle for namespace, step in steps if namespace == "/upper" for plane in step.parents]
    after_six_seconds = max(map(abs, angles[600:]))
    assert after_six_seconds < 0.02 if level else after_six_seconds > 0.2


def test_margins_of_the_page() -> None:
    rows = re.findall(
        r"^\| (\w+ \w+) \| (\d+|-) \| (\d+) \| ([\d.]+) \| (\d+) \| ([\d.]+) \|$",
        read("docs/explanation/cascade.md"),
        re.MULTILINE,
    )
    assert len(rows) == 8
    for loop, upper_slope, lower_slope, *stated in rows:
        response = loops(float(upper_slope.replace("-", "1")), float(lower_slope), 15.0)[loop]
        for text, value in zip(stated, margins(response), strict=True):
            half = 0.51 * 10.0 ** -len(text.partition(".")[2])
            assert abs(float(text) - value) <= half, (loop, upper_slope, lower_slope)


@pytest.mark.system
def test_failed_cascade_leaves_whole_bags_and_its_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "slow"
    assert main(["-o", str(path), "--bandwidth", "1"]) == 1
    assert re.match(r"error: step \d+: the plane's angle is -?1\.5", capsys.readouterr().err)
    for name in ("upper", *LOWER):
        assert json.loads((path / name / "summary.json").read_text(encoding="utf-8"))["status"] == "failed"
        assert len(load_arrays(path / name).step) > 500


def test_layers_that_do_not_fit_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in FOLDER.glob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        (tmp_path / path.name).write_text(text.replace("duration: 20.0", f"duration: {len(path.stem)}.0"), "utf-8")
    with pytest.raises(InputError, match="/lower_1: step and duration differ"):
        load_cascade(tmp_path)
    assert main(["-o", str(tmp_path / "out"), "--bandwidth", "0"]) == 2
    assert "bandwidth is 0.0; give a positive number" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.system
@pytest.mark.timeout(300)
def test_processes_over_dds_leave_the_same_digests(nothing_survives: str, tmp_path: Path) -> None:
    assert main(["-o", str(tmp_path / "processes"), "--processes", "--set", "duration=0.5"]) == 0
    cascade = load_cascade(overrides=["duration=0.5"])
    simulated = simulate_cascade(cascade, new_run_folder(tmp_path / "simulated"))
    for name in ("upper", *LOWER):
        summary = json.loads((tmp_path / "processes" / name / "summary.json").read_text(encoding="utf-8"))
        assert summary["digest"] == simulated[f"/{name}"]["digest"]
