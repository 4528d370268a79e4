"""The calibrations of a rig: measurements are simulated with known parameters, and give these back."""

import csv
import importlib.util
import re
import sys
from math import cos, exp, radians, sin, sqrt
from pathlib import Path
from random import Random
from typing import Any

import pytest
from tests.docs.pages import ROOT, blocks, read

from swarmabs_config.fleet.loader import load_fleet
from swarmabs_config.scenario import load_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.plant import Friction, Plane, PlaneDynamics, SwarmLoad, standing, swarm_load
from swarmabs_run.simulation import simulate

FOLDER = ROOT / "examples" / "build_one"
GRAVITY = 9.81
STEP = 0.0035  # s
HUNG = ((1.0, 0.2), (2.0, 0.35))  # kg, m below the axis


@pytest.fixture
def calibrate(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(FOLDER)
    spec = importlib.util.spec_from_file_location("build_one_calibrate", FOLDER / "calibrate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    yield module
    sys.modules.pop("swarmabs_serial_base", None)


def swinging(plane: Plane, moment: float, mass: float, distance: float, noise: float = 0.0) -> tuple[list, list]:
    """Let the product's plane swing with a mass below the axis; its centre has a moment (kg m) above the axis."""
    dynamics, draw = PlaneDynamics(plane, STEP), Random(1)
    load = SwarmLoad((0.0,) * 4, (mass * distance**2, *(0.0,) * 6))
    angle, rate, times, angles = plane.angle, 0.0, [], []
    for step in range(round(20.0 / STEP)):
        middle = angle + 0.5 * STEP * rate
        weight = GRAVITY * (mass * distance - moment) * sin(middle)
        angle, rate = dynamics.advance(angle, rate, step * STEP, load, weight)
        if step % 2 == 0:
            times.append(step * STEP)
            angles.append(0.02 + round((angle + draw.gauss(0.0, noise)) / 0.00015) * 0.00015)  # the offset of a sensor
    return times, angles


@pytest.mark.parametrize("moment", [-0.02, 0.03])
@pytest.mark.parametrize(("coulomb", "viscous"), [(0.008, 0.02), (0.02, 0.001), (0.0, 0.03)])
def test_swings_give_inertia_height_and_friction_back(
    calibrate: Any, moment: float, coulomb: float, viscous: float
) -> None:
    plane = Plane(inertia=0.24, friction=Friction(0.0, 1000.0, 700.0, coulomb, 1000.0, viscous), angle=0.18)
    swings = [(calibrate.swing(*swinging(plane, moment, *hung, noise=0.0003)), *hung) for hung in HUNG]
    plank = calibrate.plank(swings)
    assert plank.inertia == pytest.approx(0.24, rel=0.005)
    assert plank.moment == pytest.approx(moment, abs=0.0015)
    assert plank.coulomb == pytest.approx(coulomb, abs=0.0003)
    assert plank.viscous == pytest.approx(viscous, abs=0.001)


def test_viscous_friction_lowers_the_frequency_that_is_seen(calibrate: Any) -> None:
    """The solution of x'' + 2 a x' + w^2 x = 0 turns once in half a period of sqrt(w^2 - a^2)."""
    w, a = 2.5, 0.2
    seen = sqrt(w * w - a * a)
    times = [0.007 * n for n in range(1500)]
    found = calibrate.swing(times, [0.01 * exp(-a * time) * cos(seen * time) for time in times])
    assert found.frequency == pytest.approx(w, rel=1e-3)
    assert found.decay == pytest.approx(a, rel=1e-2)
    assert found.dead_angle == pytest.approx(0.0, abs=1e-5)


def test_swings_give_a_plank_of_parts_back(calibrate: Any) -> None:
    """In MuJoCo inertia and height follow from a box above the axis and a sphere below it, by no formula of ours."""
    mujoco = pytest.importorskip("mujoco")
    world = """<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body><joint name="axis" axis="0 -1 0"
      damping="0.01"/><geom type="box" size="0.5 0.15 0.009" mass="2.7" pos="0 0 0.009"/>
      <geom type="sphere" size="0.001" mass="{}" pos="0 0 -{}"/></body></worldbody></mujoco>"""
    swings = []
    for mass, distance in HUNG:
        model = mujoco.MjModel.from_xml_string(world.format(mass, distance))
        data = mujoco.MjData(model)
        data.qpos[0] = 0.15
        times, angles = [], []
        for _ in range(15_000):
            mujoco.mj_step(model, data)
            times.append(data.time)
            angles.append(float(data.qpos[0]))
        swings.append((calibrate.swing(times, angles), mass, distance))
    plank = calibrate.plank(swings)
    assert plank.inertia == pytest.approx(2.7 * ((1.0 + 0.018**2) / 12 + 0.009**2), rel=0.002)
    assert plank.moment == pytest.approx(2.7 * 0.009, rel=0.02)
    assert plank.viscous == pytest.approx(0.01, rel=0.02)


def test_a_balanced_mass_gives_mass_and_friction_of_the_robot(calibrate: Any) -> None:
    """The known mass is moved by millimetres until the product's plane leaves the level, to either side."""
    robot, place, known = 0.437, 0.25, 0.5
    plane = Plane(inertia=0.24, friction=Friction(0.0, 1000.0, 700.0, 0.03, 1000.0, 0.05), angle=0.0)

    def leaves(distance: float) -> float:
        """Return the speed after half a second."""
        load = swarm_load([standing(robot, place), standing(known, -distance)], GRAVITY)
        angle, rate = 0.0, 0.0
        for step in range(50):
            angle, rate = PlaneDynamics(plane, 0.01).advance(angle, rate, 0.01 * step, load)
        return rate

    level = [place for place in (0.15 + 0.0005 * n for n in range(300)) if abs(leaves(place)) < 0.003]
    mass, friction = calibrate.balance(known, place, min(level), max(level))
    assert mass == pytest.approx(robot, abs=0.002)
    assert friction == pytest.approx(0.03, rel=0.1)


def test_a_robot_tips_where_its_centre_of_mass_passes_a_contact(calibrate: Any) -> None:
    wheelbase, height, behind = 0.07, 0.031, 0.028

    def tips(lever: float) -> float:
        """Return the slope, degrees, at which the centre turned about the contact is no longer behind it."""
        slope = 0.0
        while -lever * cos(radians(slope)) + height * sin(radians(slope)) < 0.0:
            slope += 0.01
        return slope

    found = calibrate.centre(wheelbase, radians(tips(behind)), radians(tips(wheelbase - behind)))
    assert found == pytest.approx((height, behind), rel=1e-3)


def test_a_level_turned_end_for_end_gives_the_sensor_and_itself(calibrate: Any) -> None:
    """The level shows 0 at its own error, and turned at minus that; plane_driver adds the offset to the reading."""
    sensor, level = 0.0123, -0.004
    readings = [tilt - sensor for tilt in (level, -level)]
    assert calibrate.offset(*readings) == pytest.approx((sensor, level))


def test_the_scenario_of_the_example_levels_the_plank() -> None:
    run = simulate(load_scenario(FOLDER / "plank.yaml", ["duration=4"]))
    assert run.angle[0] == pytest.approx(0.05, abs=1e-4)
    assert max(map(abs, run.angle[-100:])) < 0.002


def test_the_fleet_takes_the_reference_of_the_page(tmp_path: Path) -> None:
    """Its firmware allows the speed and the deceleration that the fleet file states."""
    (tmp_path / "plank.yaml").write_text((FOLDER / "plank.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    text = (FOLDER / "fleet" / "plank.yaml").read_text(encoding="utf-8")
    (page,) = blocks(read("docs/how-to/build_one.md"), "yaml")
    path = tmp_path / "fleet" / "plank.yaml"
    path.parent.mkdir()
    path.write_text(f"{text}\n{page}", encoding="utf-8")
    loaded = load_fleet(path)
    (tmp_path / "all.yaml").write_text(loaded.scenario_text, encoding="utf-8")
    run = simulate(tmp_path / "all.yaml", {"duration": 13.0})
    assert max(abs(angle - 0.08) for angle in run.angle[-100:]) < 0.005
    sketch = (FOLDER / "firmware" / "robot" / "robot.ino").read_text(encoding="utf-8")
    *_, robot = re.findall(r"CONFIG = \{(\d+), (\d+), ([\de.]+)F,", sketch)
    for member in loaded.fleet.robots:
        assert member.limits.velocity is not None
        assert member.limits.deceleration is not None
        assert member.limits.velocity * 1e6 <= float(robot[1])
        assert member.limits.deceleration * 1e6 == float(robot[2])


def test_the_commands_print_settings(calibrate: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plane = Plane(inertia=0.24, friction=Friction(0.0, 1000.0, 700.0, 0.008, 1000.0, 0.02), angle=0.18)
    files = []
    for number, hung in enumerate(HUNG):
        files += ["--swing", str(tmp_path / f"{number}.csv"), *map(str, hung)]
        with (tmp_path / f"{number}.csv").open("w", encoding="utf-8", newline="") as file:
            rows = zip(*swinging(plane, -0.02, *hung), strict=True)
            csv.writer(file).writerows([("time", "position"), *rows])
    assert calibrate.main(["swing", *files]) == 0
    inertia, friction, moment = capsys.readouterr().out.splitlines()
    assert float(inertia.split()[1]) == pytest.approx(0.24, rel=0.01)
    assert friction.startswith("plane.friction: [0, 1000, 700, 0.00")
    assert float(moment.split()[-3]) == pytest.approx(-0.02, abs=0.002)
    calls = {
        "balance --known 0.5 --place 0.25 --inner 0.2 --outer 0.24": "robots[].mass: 0.4400",
        "centre --wheelbase 0.07 --forwards 45 --backwards 45": "centre of mass: 0.0350 m above",
        "offset --first -0.01 --second -0.02": "offset: 0.01500",
        "scale --distance 0.8 --counted 0.79 -0.81": "scale: 1.00000",
    }
    for words, said in calls.items():
        assert calibrate.main(words.split()) == 0
        assert said in capsys.readouterr().out


def test_useless_measurements_are_refused(calibrate: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    still = tmp_path / "still.csv"
    still.write_text("time,position\n0,0.1\n1,0.1\n2,0.1\n", encoding="utf-8")
    (tmp_path / "other.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    swing = calibrate.Swing(2.0, 0.0, 0.0)
    with pytest.raises(InputError, match="one mass at one distance"):
        calibrate.plank([(swing, 1.0, 0.2), (swing, 1.0, 0.2)])
    for words, said in (
        (["swing", "--swing", str(still), "1", "0.2"], "still.csv: the record has 0 turning points instead of 5"),
        (["swing", "--swing", str(tmp_path / "other.csv"), "1", "0.2"], "other.csv: no record with time and position"),
        (["swing", "--swing", str(still), "heavy", "0.2"], "--swing: could not convert"),
    ):
        assert calibrate.main(words) == 2
        assert said in capsys.readouterr().err
