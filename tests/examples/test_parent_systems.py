"""The example parent systems: ship, plate and payload, simulated, against solutions in continuous time."""

import json
import math
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from examples.payload.tests.reference import Payload
from examples.plate.tests.reference import Plate
from examples.reference_tools import Array, Event, Gains, Loop, Robots, Solution, System
from examples.ship.tests.reference import Ship
from tests.examples.test_packages import python
from tests.plugin_packages import install
from tests.processes import ROOT

from swarmabs_analysis.losses import check as losses
from swarmabs_analysis.losses.check import check_losses
from swarmabs_config.scenario import SystemScenario, load_scenario, warnings_of
from swarmabs_core.messages import Status
from swarmabs_core.theory.report import Report, Theorem
from swarmabs_run.simulation import simulate

NAMES = ("ship", "plate", "payload")
ALTERNATE = tuple(range(1, 13, 2))
ALL = tuple(range(1, 13))
PATHS = {path.stem: path for name in NAMES for path in sorted((ROOT / "examples" / name).glob("*.yaml"))}
SYSTEMS: Mapping[str, type[System]] = {"ship": Ship, "plate": Plate, "payload": Payload}
ANGLES = {"ship": slice(1), "plate": slice(2), "payload": slice(3)}
"""What is compared: angles, or the position of the payload."""
LOSS = "faults=[{{kind: drive_failure, agent: 3, from: {0}}}, {{kind: remove, agent: 3, at: {1}}}]"


@pytest.fixture(autouse=True)
def _installed(packages: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.syspath_prepend(ROOT / "examples" / name)
        target = f"swarmabs_{name}:{name.upper()}"
        install(packages, "system", name, "", package=f"swarmabs-{name}-here", target=target)


def given(name: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(PATHS[name].read_text(encoding="utf-8"))
    return found


@cache
def simulated(name: str, duration: float, *overrides: str) -> Any:
    return simulate(load_scenario(PATHS[name], [f"duration={duration}", *overrides]))


def forces(ids: Sequence[int]) -> list[str]:
    """Return overrides that make robots force-driven."""
    return [f"swarm.agents.{robot - 1}.kind=double_integrator" for robot in ids]


def solution(
    name: str, duration: float, events: Sequence[Event] = (), ids: Sequence[int] = (), **parts: Any
) -> Solution:
    """Return the continuous solution of a scenario in which some robots are force-driven."""
    scenario = given(name)
    robots, gains = Robots.of(scenario["swarm"]["agents"]), scenario["swarm"]["gains"]
    kinds = tuple("double_integrator" if i in ids else k for i, k in zip(robots.ids, robots.kinds, strict=True))
    system = SYSTEMS[scenario["system"]["type"]](**parts)
    return Loop(system, replace(robots, kinds=kinds), Gains(**gains), events=events).solve(duration, rtol=1e-8)


def differences(run: Any, expected: Solution, late: float, *groups: slice) -> list[tuple[float, float]]:
    """Return the largest differences of quantities of the parent: in the whole run, and from a time (s) on."""
    off = np.abs(run.parent - expected.parent)
    return [(float(off[:, group].max()), float(off[round(100 * late) :, group].max())) for group in groups]


CASES: Mapping[str, tuple[str, tuple[float, float], Sequence[str], Sequence[Event], Sequence[int]]] = {
    "ship": ("ship", (7.0e-4, 5.6e-4), (), (), ()),
    "plate, mixed": ("plate", (1.3e-3, 3.3e-5), forces(ALTERNATE), (), ALTERNATE),
}
"""Scenario, and the differences that sampling at 10 ms makes: in the whole run, and from 5 s on, rad."""


@pytest.mark.parametrize("case", CASES)
@pytest.mark.system
def test_a_sampled_run_is_as_close_to_the_continuous_one_as_10_ms_allow(case: str) -> None:
    name, expected, overrides, events, ids = CASES[case]
    run = simulated(name, 6.0, *overrides)
    ((whole, late),) = differences(run, solution(name, 6.0, events, ids), 5.0, ANGLES[name])
    assert whole < 1.5 * expected[0]
    assert late < 1.5 * expected[1]


def spread_around(moving: Array, standing: Array, there: Array) -> float:
    """Return the largest error of the second moment of the robots that move about their centre, as a share of it.

    It is 0.15 n n'/M + 0.15 (M_A/M)^2 kg m^2 in each direction, with the first moment n and the mass M of all.
    """
    masses = np.array([agent["constants"]["mass"] for agent in given("plate")["swarm"]["agents"]])
    m, whole = masses[there], 4.8
    n = m @ moving + masses[~there] @ standing
    centre = m @ moving / m.sum()
    found = np.einsum("i,ij,ik", m, moving - centre, moving - centre)
    wanted = 0.15 * np.outer(n, n) / whole + 0.15 * (m.sum() / whole) ** 2 * np.eye(2)
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


@pytest.mark.system
def test_a_robot_leaves_or_stands() -> None:
    """It may leave at 1 s with its weight, or stand where it is: the plate follows the continuous solution."""
    for fault, what in (("remove", "leaves"), ("kill", "stands")):
        run = simulated("plate", 4.0, f"faults=[{{kind: {fault}, agent: 4, at: 1.0}}]")
        expected = solution("plate", 4.0, (Event(1.0, 4, what),))
        ((whole, late),) = differences(run, expected, 3.0, slice(2))
        assert whole < 1.5 * 1.1e-3
        assert late < 5e-5
        q = np.stack([run["x"], run["y"]], axis=2)
        there = ~np.isnan(q[150, :, 0])
        assert there.sum() == 11
        if fault == "remove":
            assert np.abs(q[150] - expected.coordinates[150])[there].max() < 2e-3
        else:  # the others spread around it, which the angles do not show
            assert spread_around(q[400, there], q[100, ~there], there) < 0.02


@pytest.mark.parametrize("number", [3, 40])
@pytest.mark.system
def test_a_ring_of_any_size_levels_the_plate(number: int) -> None:
    run = simulated(f"plate_{number}", 2.0)
    ((whole, _),) = differences(run, solution(f"plate_{number}", 2.0), 1.0, slice(2))
    assert whole < 1.5 * 1.1e-3
    error = np.abs(run.parent[:, :2] - run.reference).max(axis=1)
    assert error[:100].max() > 0.05
    assert error[107:].max() < 0.01


@pytest.mark.parametrize("number", [4, 40])
def test_the_ship_rolls_alike_with_any_number_of_trolleys(number: int) -> None:
    run, other = simulated(f"ship_{number}", 2.0), simulated("ship", 2.0)
    assert np.abs(run["roll"] - other["roll"]).max() < 2e-4
    order = np.argsort(run["position"], axis=1)
    assert (order == order[0]).all()  # with the mass as weight, no trolley overtakes another


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("name", "force"),
    [
        *(("ship_4", True), ("plate", False)),
        *(pytest.param(*of, marks=pytest.mark.full) for of in (("ship", False), ("ship_4", False), ("plate_3", True))),
    ],
)
@pytest.mark.system
def test_robots_that_die_do_not_fling_the_others(name: str, *, force: bool) -> None:
    """With a completion that ignores them, trolleys of ship_4 reach 100 m/s and more after 2 or 4 has died."""
    count = len(given(name)["swarm"]["agents"])
    kinds = forces(range(1, count + 1)) if force else []
    followed = {"ship": 1, "plate": 2}[name.split("_", maxsplit=1)[0]]

    def error(run: Any) -> float:
        return float(np.abs(run.parent[300:, :followed] - run.reference[300:]).max())

    usual = error(simulated(name, 4.0, *kinds))
    for robot in {2, count} if count < 12 else {count}:
        run = simulated(name, 4.0, *kinds, f"faults=[{{kind: kill, agent: {robot}, at: 1.0}}]")
        assert np.nanmax(np.abs(run.agents.velocities[101:])) < 1.0
        assert error(run) < 1.1 * usual
        assert {event.kind for event in run.events} == {"dead"}


@pytest.mark.timeout(300)
@pytest.mark.system
def test_ship_4_bears_the_loss_of_any_trolley_and_of_any_pair(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(losses, "AFTER_ANY", 1.5)
    report = check_losses(
        load_scenario(PATHS["ship_4"], ["duration=4.0"]),
        Report("", "", "", None, (), Theorem("", ""), {}, {}, ()),
        any_loss=True,
    )
    assert len(report.losses) > 10
    assert max(loss.speed for loss in report.losses) < 2.0
    assert {name for loss in report.losses for name in loss.failed} == set()


@pytest.mark.system
def test_the_swarm_takes_a_twentieth_of_the_roll() -> None:
    without = simulated("ship_4", 16.0, "system.rate_gain=0", "system.estimator=0")
    run = simulated("ship_4", 16.0)
    roll, alone = (np.sqrt(np.mean(each["roll"][800:] ** 2)) for each in (run, without))
    assert alone > 0.05
    assert roll < alone / 20.0


def tilt(run: Any) -> Array:
    """Return the larger of roll and pitch angle, (n+1,)."""
    return np.maximum(np.abs(run["roll"]), np.abs(run["pitch"]))  # type: ignore[no-any-return]


@pytest.mark.parametrize("reaction", [0.016, pytest.param(0.0, marks=pytest.mark.full)], ids=["yaw", "no_yaw"])
@pytest.mark.system
def test_the_payload_bears_the_failure_of_a_rotor(reaction: float) -> None:
    """Nobody knows of it for 0.1 s; the attitude is back 0.5 s after the failure."""
    run = simulated("payload", 3.5, LOSS.format(2.0, 2.09), f"system.reaction={reaction}")
    expected = solution("payload", 3.5, (Event(2.0, 3, "fails", 0.1),), yaw=bool(reaction))
    places, angles = differences(run, expected, 3.0, slice(3), slice(6, 9))
    assert places[0] < 1.5 * 4.7e-3
    assert angles[0] < 1.5 * 1.8e-3
    assert tilt(run)[200:].max() > 0.05
    assert tilt(run)[250:300].max() < 0.05
    assert set(run["thrust"][200:210, 2]) == {run["thrust"][200, 2]}  # what it says meanwhile
    assert np.isnan(run["thrust"][210, 2])


@pytest.mark.system
def test_the_payload_follows_its_path() -> None:
    run = simulated("payload", 4.5, "faults=[]")
    places, angles = differences(run, solution("payload", 4.5), 4.0, slice(3), slice(6, 9))
    assert places[0] < 1.5 * 1.3e-3
    assert angles[0] < 1.5 * 4.5e-4
    error = run.parent[:, :3] - run.reference
    assert np.abs(error[350:, 2]).max() < 0.03


@pytest.mark.system
def test_rotors_at_their_limits_say_so_and_the_others_take_over() -> None:
    run = simulated("overloaded", 5.0, LOSS.format(3.0, 3.09), "system.distance=0", "system.height=0")
    limited = run.agents.status == Status.LIMITED
    assert limited[:300].sum() == 0
    assert limited[310:].any(axis=0).sum() > 3
    highest = np.array([agent["constants"]["highest"] for agent in given("overloaded")["swarm"]["agents"]])
    assert np.nanmin(run["thrust"]) > 0.0
    assert (np.nan_to_num(run["thrust"]) <= highest + 1e-12).all()
    assert tilt(run)[350:].max() < 0.06
    assert np.abs(run["z"][300:]).max() < 0.1


def test_the_spin_of_the_robots_follows_from_the_abstract_state() -> None:
    """It is exact where velocities are affine with a symmetric matrix, as those of the law are."""
    plate = load_scenario(PATHS["plate"], []).named.instance  # type: ignore[union-attr]
    draw = np.random.default_rng(1)
    m, q = draw.uniform(0.2, 0.6, 12), draw.normal(0.1, 0.3, (12, 2))
    m *= 4.8 / m.sum()
    matrix = draw.normal(size=(2, 2))
    v = draw.normal(size=2) + q @ (matrix + matrix.T)
    a, rate = np.zeros(5), np.zeros(5)
    for mass, place, velocity in zip(m, q, v, strict=True):
        a += plate.contribution(tuple(place), (mass, 0.0))
        rate += np.array(plate.jacobian(tuple(place), (mass, 0.0))) @ velocity
    spin = m @ (q[:, 0] * v[:, 1] - q[:, 1] * v[:, 0])
    assert plate.spin(tuple(a), tuple(rate)) == pytest.approx(spin, rel=1e-12)
    line = np.sum([plate.contribution((x, 2.0 * x), (1.6, 0.0)) for x in (-0.1, 0.2, 0.3)], axis=0)
    assert plate.spin(tuple(line), (1.0,) * 5) == pytest.approx((line[0] - line[1]) / 9.81**2 / 4.8)


@pytest.mark.parametrize("name", PATHS)
def test_every_scenario_runs_without_warning(name: str) -> None:
    assert warnings_of(load_scenario(PATHS[name], [])) == ()
    run = simulated(name, 0.05, "faults=[]")
    assert len(run.time) == 6 and np.isfinite(run.parent).all()


@pytest.mark.parametrize("name", NAMES)
def test_a_system_is_short_and_can_be_drawn(name: str) -> None:
    source = ROOT / "examples" / name / f"swarmabs_{name}.py"
    assert len(source.read_text(encoding="utf-8").splitlines()) <= 170
    scenario = load_scenario(PATHS[name], [])
    assert isinstance(scenario, SystemScenario)
    made: Any = scenario.named.instance
    tilted = tuple(0.2 if row.unit == "rad" else 0.0 for row in made.parent)
    for state in (made.initial, tilted):
        for line in made.outline(state):
            assert len(line) > 1 and all(len(point) == 2 and all(map(math.isfinite, point)) for point in line)
    if name == "ship":  # roll is positive where the side of negative p goes down
        assert made.robot_place(tilted, (1.0,), (100.0, 0.0)) == pytest.approx((math.cos(0.2), math.sin(0.2), 0.2))
        assert made.reach((1000.0, 200.0)) and not made.reach((1000.0, 5.0)) and not made.reach((0.0, 9000.0))
    if name == "payload":  # a rotor is drawn higher with more thrust
        low, high = (made.robot_place(made.initial, (thrust,), (0.5, 0.3, 1.0, 0.05, 12.0)) for thrust in (1.0, 5.0))
        assert high[0] == low[0] and high[1] > low[1]
    steep = tuple(1.45 if row.unit == "rad" else 0.0 for row in made.parent)
    assert made.failed(made.initial) == "" and made.failed(steep)


LONG: Mapping[str, tuple[str, tuple[float, float], float, float, Sequence[str], Sequence[Event], Sequence[int]]] = {
    "ship": ("ship", (7.0e-4, 5.6e-4), 60.0, 5.0, (), (), ()),
    "ship, force robots": ("ship", (7.1e-4, 6.3e-4), 60.0, 5.0, forces(ALL), (), ALL),
    "ship, mixed": ("ship", (7.1e-4, 5.9e-4), 60.0, 5.0, forces(ALTERNATE), (), ALTERNATE),
    "ship, robot 4 leaves": (
        *("ship", (7.0e-4, 5.5e-4), 60.0, 35.0),
        *(("faults=[{kind: remove, agent: 4, at: 30.0}]",), (Event(30.0, 4, "leaves"),), ()),
    ),
    "plate, robot 4 leaves": (
        *("plate", (1.1e-3, 1.3e-5), 30.0, 20.0),
        *(("faults=[{kind: remove, agent: 4, at: 15.0}]",), (Event(15.0, 4, "leaves"),), ()),
    ),
    "plate, force robots": ("plate", (1.6e-3, 4.4e-5), 30.0, 5.0, forces(ALL), (), ALL),
    "plate, mixed": ("plate", (1.3e-3, 3.3e-5), 30.0, 5.0, forces(ALTERNATE), (), ALTERNATE),
    "payload": ("payload", (1.3e-3, 8.8e-5), 20.0, 15.0, ("faults=[]",), (), ()),
    "payload, rotor 3 fails": ("payload", (4.7e-3, 9.8e-5), 20.0, 15.0, (), (Event(10.0, 3, "fails", 0.1),), ()),
}
"""As `CASES`, with duration and the time from which the second difference counts, s."""


@pytest.mark.full
@pytest.mark.timeout(300)
@pytest.mark.parametrize("case", LONG)
def test_a_long_run_is_as_close_to_the_continuous_one(case: str) -> None:
    name, expected, duration, from_time, overrides, events, ids = LONG[case]
    run = simulated(name, duration, *overrides)
    ((whole, late),) = differences(run, solution(name, duration, events, ids), from_time, ANGLES[name])
    assert whole < 1.5 * expected[0]
    assert late < 1.5 * expected[1]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the packages, without network, into a folder; return the folder."""
    folder, source = tmp_path_factory.mktemp("installed"), tmp_path_factory.mktemp("source")
    for name in NAMES:
        shutil.copytree(ROOT / "examples" / name, source / name)  # pip builds where the source is
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--no-deps", "--no-build-isolation"]
    words = [*pip, "--no-index", "--target", str(folder), *map(str, source.iterdir())]
    subprocess.run(words, stdout=subprocess.DEVNULL, timeout=100.0, check=True)
    return folder


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("nothing_survives")
@pytest.mark.parametrize("name", NAMES)
def test_processes_and_simulation_agree(installed: Path, tmp_path: Path, name: str) -> None:
    def swarm(*words: object) -> Any:
        return json.loads(python("-m", "swarmabs_cli", *words, "--json", cwd=tmp_path, path=(installed,)))

    words = [PATHS[name], "--duration", "0.6"]
    if name == "payload":
        words += ["--set", LOSS.format(0.2, 0.29)]
    run = swarm("run", *words, "-o", "run")
    assert (run["status"], run["steps"]) == ("ok", 60)
    assert run["digest"] == swarm("simulate", *words, "-o", "simulated")["digest"]
    assert swarm("simulate", "run", "-o", "again")["digest"] == run["digest"]
    assert swarm("verify", "run")["ok"]
