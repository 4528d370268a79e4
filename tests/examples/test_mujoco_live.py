"""The rig in MuJoCo as hardware: its pace, its messages, its place in a run, and a swarm that levels it over DDS."""

import json
import os
import subprocess
import sys
from ctypes.util import find_library
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation
from tests.docs.pages import ROOT
from tests.swarmabs_core.helpers import builtin
from tests.system.helpers import bag_messages, swarm

from swarmabs_bag.run_folder import RunFolder
from swarmabs_config.graph import REALTIME
from swarmabs_core.cdr import decode
from swarmabs_core.messages import PlaneState
from swarmabs_run.orchestration.plan import plan

RIG = ROOT / "examples" / "mujoco" / "rig"
SECOND = 10**9


@pytest.fixture
def example(mujoco_example: dict[str, Any]) -> dict[str, Any]:
    """Return the modules of the example by name."""
    return mujoco_example


def paced(pacing: Any, lateness: list[int]) -> Any:
    """Reach every 10 ms of the world as late as given, ns."""
    for number, late in enumerate(lateness, start=1):
        time = 0.01 * number
        pacing.reached(time, pacing.due(time) + late)
    return pacing


def test_a_world_that_is_a_little_late_catches_up(example: dict[str, Any]) -> None:
    pacing = paced(example["pacing"].Pacing(SECOND), [0, 19_000_000, 5_000_000] * 50)
    assert pacing.due(1.5) == pytest.approx(SECOND + 1.5e9, abs=1.0)
    assert pacing.factor == pytest.approx(1.0, abs=0.03)


def test_the_world_of_a_slow_machine_loses_time_and_never_jumps(example: dict[str, Any]) -> None:
    pacing, clock = example["pacing"].Pacing(0), 0
    for step in range(1, 501):
        clock = max(clock, pacing.due(0.01 * step)) + 20_000_000  # a period of the world takes two
        pacing.reached(0.01 * step, clock)
        assert clock - pacing.due(0.01 * (step + 1)) <= 10_000_001  # it is never asked for more than it makes up for
    assert pacing.factor == pytest.approx(0.5, abs=0.01)
    assert clock == pytest.approx(10e9, rel=0.01)


def test_a_world_can_be_slow_on_purpose(example: dict[str, Any]) -> None:
    pacing = paced(example["pacing"].Pacing(0, speed=0.25), [0] * 200)
    assert pacing.due(2.0) == 8 * SECOND
    assert pacing.factor == pytest.approx(0.25)


def test_the_world_goes_on_where_it_was_after_a_pause(example: dict[str, Any]) -> None:
    pacing = paced(example["pacing"].Pacing(0), [0] * 200 + [3 * SECOND])
    assert pacing.due(2.02) == pytest.approx(5.0e9, abs=1e7)
    assert pacing.factor < 0.4
    assert paced(pacing, []).factor < 0.4
    for number in range(202, 402):
        pacing.reached(0.01 * number, pacing.due(0.01 * number))
    assert pacing.factor == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("facing", [1.0, -1.0])
def test_an_imu_measures_how_a_body_is_turned_in_space(example: dict[str, Any], facing: float) -> None:
    angle, rate = 0.3, 0.7
    readings = example["mujoco_rig"].Readings(0.0, angle, (angle, rate), {})
    message = example["mujoco_node"].imu(readings, facing)
    q = message.orientation
    axes = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    forward, _, up = axes.T
    np.testing.assert_allclose(forward, facing * np.array([cos(angle), 0.0, sin(angle)]), atol=1e-12)
    np.testing.assert_allclose(up, [-sin(angle), 0.0, cos(angle)], atol=1e-12)
    # The plane turns about the axis that leads from x to z: -y.
    spin = axes @ [message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z]
    np.testing.assert_allclose(spin, [0.0, -rate, 0.0], atol=1e-12)


def test_the_processes_of_a_run_use_the_rig_instead_of_simulated_bodies(
    example: dict[str, Any], tmp_path: Path
) -> None:
    live, scenario = example["mujoco_live"], builtin("pd_het_4")
    processes = plan(scenario, RunFolder(tmp_path), driver=REALTIME)
    rig = example["mujoco_node"].RigSettings(base="differential")
    changed = {process.name: process for process in live.Arrangement(scenario, rig, "imu", "wheel")(processes)}
    assert next(iter(changed)) == "plane_driver" and list(changed)[-1] == "mujoco_rig"
    assert "plane_sim" not in changed
    assert len({process.participant for process in changed.values()}) == len(changed) == len(processes) + 1
    assert changed["plane_driver"].module == "plane_sim.driver"
    sensor = changed["plane_driver"].parameters
    assert (sensor["source"], sensor["age_limit"]) == ("imu", pytest.approx(0.05 + 0.02))
    assert changed["recorder"].parameters["driven"] == [1, 2, 3, 4]
    assert changed["recorder"].parameters["simulated_plane"] is False
    backwards = changed["agent_003"].parameters
    assert (backwards["drive.type"], backwards["drive.joint.name"]) == ("topic", "left_wheel_joint")
    assert (backwards["drive.reversed"], backwards["drive.joint.scale"]) == (True, 0.02)
    assert backwards["drive.offset"] == scenario.agents[2].position
    ahead = live.Arrangement(scenario, rig, "encoder", "odometry")(processes)[4].parameters
    assert (ahead["drive.axis"], ahead["drive.source"]) == ("+x", "odometry")


def test_true_states_are_read_up_to_the_last_step_as_far_as_they_are_complete(
    example: dict[str, Any], tmp_path: Path
) -> None:
    live = example["mujoco_live"]
    (tmp_path / "logs").mkdir()
    network = tmp_path / "logs" / "network.json"
    network.write_text("{}", encoding="utf-8")
    assert live.true_states(tmp_path, SECOND) == []
    network.write_text(json.dumps({"epoch": 2 * SECOND}), encoding="utf-8")
    assert live.true_states(tmp_path, SECOND) == []
    rows = [f"{number * SECOND},{0.5 * number},0.5,{float(number < 2)},{0.1 - 0.01 * number}" for number in range(9)]
    text = "stamp,time,factor,held,angle\n" + "\n".join(rows)
    (tmp_path / "truth.csv").write_text(text, encoding="utf-8")
    states = live.true_states(tmp_path, 4 * SECOND)
    assert [state["stamp"] for state in states] == [number * SECOND for number in range(7)]
    assert len(live.true_states(tmp_path, 100 * SECOND)) == 8  # the last line is still being written
    assert live.shown(states) == (0.5, 0.5, pytest.approx(0.04))
    assert live.shown(states[:2]) is None
    assert "true angle at the end 0.0400 rad" in live.summary(tmp_path, 4 * SECOND)
    assert "was never released" in live.summary(tmp_path, 0)


def test_the_start_script_names_what_it_can_start() -> None:
    answer = subprocess.run([RIG, "fly"], capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert answer.stderr.startswith("usage: rig live|trial|film")


@pytest.mark.system
@pytest.mark.skipif(find_library("EGL") is None, reason="EGL is not installed")
@pytest.mark.usefixtures("mujoco_example")
def test_a_film_shows_the_plank_and_its_reference(tmp_path: Path) -> None:
    film = tmp_path / "film.webp"
    words = [sys.executable, RIG.with_name("film.py"), "pd_si_4", "--duration", "0.2", "-o", film]
    environment = {**os.environ, "MUJOCO_GL": "egl"}
    environment.pop("PYTHONSAFEPATH", None)  # the tests have it, the shell of a user has not
    said = subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout
    assert said.startswith(f"{film}: 0.0")
    with Image.open(film) as pictures:
        assert (pictures.n_frames, pictures.size) == (3, (640, 400))
        frame = np.asarray(pictures.convert("RGB"), dtype=int)
    view = frame[40:320]  # below the words, above the curves
    reddest = view[..., 0] - view[..., 1:].max(axis=2) > 90
    columns = np.flatnonzero(reddest.any(axis=0))
    rows = np.array([np.flatnonzero(reddest[:, column]).mean() for column in columns])
    assert len(columns) > 300  # the line of the reference, which is level, from end to end of the plank
    wooden = (view[..., 0] - view[..., 2] > 40) & ~reddest
    assert wooden.sum() > 5_000
    assert abs(np.polyfit(columns, rows, 1)[0]) < 0.1  # seen nearly from the side


def test_the_lock_pins_what_the_tests_use() -> None:
    def pins(path: Path) -> dict[str, str]:
        lines = path.read_text(encoding="utf-8").splitlines()
        return dict(line.split()[0].split("==") for line in lines if "==" in line.split(";")[0] and line[0] != " ")

    tested = pins(ROOT / "scripts" / "requirements" / "test.lock")
    assert pins(RIG.with_name("requirements.lock")).items() <= tested.items()


SCENARIO = """\
schema: 1
name: two_rovers
plane: {angle: 0.08}
controller: {type: pd, gains: [4.0, 4.0]}
limits: {velocity: 0.5}
swarm:
  gains: {k: [4.0, 4.0]}
  agents:
    - {id: 1, kind: single_integrator, mass: 0.5, position: 0.15}
    - {id: 3, kind: single_integrator, mass: 0.4, position: -0.12}
"""


@pytest.mark.system
@pytest.mark.timeout(360)
@pytest.mark.usefixtures("nothing_survives")
def test_rovers_level_the_plank_over_dds_and_the_bag_verifies(example: dict[str, Any], tmp_path: Path) -> None:
    """On a machine that is too busy the world is slow, and robots stop now and then: then the run is longer."""
    live, scenario = example["mujoco_live"], tmp_path / "two_rovers.yaml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    perfect = ["--mass-error=0", "--tilt-offset=0", "--delay=0", "--grip=1"]
    for duration in (10, 30, 90):
        folder = tmp_path / f"run_{duration}"
        assert live.main([str(scenario), "-o", str(folder), f"--duration={duration}", *perfect]) == 0
        truth = live.true_states(folder, duration * SECOND)
        if max(abs(row["angle"]) for row in truth[-100:]) < 0.03:
            break
    else:
        pytest.fail(f"the plank is not level: {truth[-1]}")
    assert truth[0]["angle"] == pytest.approx(0.08, abs=1e-6)
    assert {row["held"] for row in truth} == {0.0, 1.0}
    for robot in (1, 3):
        places = [row[f"position_{robot}"] for row in truth]
        assert max(places) - min(places) > 0.01  # both work
    assert live.shown(truth).slowest > 0.0
    verified = swarm("verify", folder)
    assert verified.code == 0, verified.err
    assert "the motion of robots 1, 3, which was measured" in verified.out
    # What the nodes have recorded is what the world did, up to the noise of its sensors and the age of the readings.
    states = [(m.stamp, decode(PlaneState, m.payload)) for m in bag_messages(folder) if m.topic == "plane/state"]
    stamps = [row["stamp"] for row in truth]
    true_angles = np.interp([stamp for stamp, _ in states], stamps, [row["angle"] for row in truth])
    errors = [state.angle - angle for (_, state), angle in zip(states, true_angles, strict=True)]  # type: ignore[attr-defined]
    assert 1e-5 < np.median(np.abs(errors)) < 0.005
