"""The rig's physics, and the swarm's nodes on it by way of stock ROS messages."""

import importlib.util
import sys
from math import cos, sin
from pathlib import Path
from typing import Any

import pytest
from tests.docs.pages import ROOT

FOLDER = ROOT / "examples" / "hardware_in_the_loop"


def load(name: str) -> Any:
    """Import a module of the example under a name of its own, its neighbours by theirs."""
    spec = importlib.util.spec_from_file_location(f"hardware_in_the_loop_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(FOLDER)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)  # the tests have it, the shell of a user has not
    return load("run")


@pytest.fixture
def physics() -> Any:
    return load("rig")


def test_the_rig_loses_no_energy_without_friction(physics: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Free bodies on a free plane: kinetic energy of both and height of the bodies together stay what they were."""
    monkeypatch.setattr(physics, "friction", lambda rate: 0.0)
    monkeypatch.setattr(physics, "END_STOP", 10.0)
    monkeypatch.setattr(physics, "LENGTH", 100.0)
    robots = tuple(
        physics.Robot(number, "double_integrator", mass, 0.0, place, 1.0, "localisation")
        for number, mass, place in ((1, 0.4, 0.2), (2, 0.7, -0.15))
    )
    rig = physics.Rig(robots)
    rig.held, rig.angle, rig.rate = False, 0.3, 0.8
    rig.bodies[1].velocity = 0.5

    def energy() -> float:
        total = 0.5 * physics.INERTIA * rig.rate**2
        for body in rig.bodies.values():
            p, v, e = body.position, body.velocity, rig.angle
            # Velocity in space of a point at p (cos e, sin e).
            across, up = v * cos(e) - p * rig.rate * sin(e), v * sin(e) + p * rig.rate * cos(e)
            total += body.robot.mass * (0.5 * (across**2 + up**2) + physics.GRAVITY * p * sin(e))
        return float(total)

    before, swing = energy(), set()
    for milliseconds in range(1000):
        for robot in rig.bodies:
            rig.drive(robot, 0.0)
        rig.advance((milliseconds + 1.5) / 1000)
        swing.add(round(rig.angle, 2))
    assert energy() == pytest.approx(before, rel=1e-9)
    assert len(swing) > 10  # it moved


def test_a_folder_in_use_is_refused(example: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "kept").write_text("x", encoding="utf-8")
    assert example.main(["-o", str(tmp_path)]) == 2
    assert "is not empty; give another folder" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_a_plane_that_hits_its_stop_fails_the_run(example: Any, capsys: pytest.CaptureFixture[str]) -> None:
    swing = [{"time": 0.5 * n, "angle": angle} for n, angle in enumerate((0.1, 0.4, -0.499, 0.0))]
    assert example.judged(swing) == 0
    swing[2]["angle"] = -0.5
    assert example.judged(swing) == 1
    assert "the plane has hit its end stop at 0.5 rad after 1.00 s" in capsys.readouterr().err


def is_level(found: list[dict[str, float]]) -> bool:
    """Tell whether the plane has been level for the last second, after 8 s at the earliest."""
    now = found[-1]["time"]
    return now > 9.0 and all(abs(row["angle"]) < 0.02 for row in found if row["time"] > now - 1.0)


def travelled(found: list[dict[str, float]], robot: int) -> float:
    """Return the distance, m, between the outermost positions of a robot."""
    positions = [row[f"position_{robot}"] for row in found]
    return max(positions) - min(positions)


@pytest.mark.system
@pytest.mark.timeout(240)
@pytest.mark.usefixtures("nothing_survives")
def test_the_swarm_levels_the_rig_and_stops_without_the_plane_s_sensor(example: Any, tmp_path: Path) -> None:
    """On a machine that is too busy for real time robots stop now and then, and the plane is level later."""
    with example.running(tmp_path) as run:
        run.wait(9.1)
        while not is_level(found := example.rows(run.truth)):
            assert found[-1]["time"] < 150.0, f"the plane is not level: {found[-1]}"
            run.wait(run.time() + 0.5)
        run.kill("plane_driver")
        still_from = run.time() + 3.0
        run.wait(still_from + 0.5)
        after = [row for row in example.rows(run.truth) if row["time"] >= still_from]
    assert found[0]["angle"] == pytest.approx(0.1, abs=0.01)
    assert all(travelled(found, robot.id) > 0.005 for robot in example.ROBOTS)  # all work
    # The brake of a double integrator, m v / 0.1 s, does not hold its weight: it creeps down the tilted plane.
    creep = 0.1 * 9.81 * max(abs(sin(row["angle"])) for row in after)
    for robot in example.ROBOTS:
        speed = creep if robot.kind == "double_integrator" else 0.0
        assert travelled(after, robot.id) < 0.005 + 1.2 * speed * (after[-1]["time"] - after[0]["time"]), robot.id
