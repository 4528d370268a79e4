"""The rig in MuJoCo: its plank is that of the paper, its sensors are late, and the swarm levels it."""

import importlib
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from tests.docs.pages import ROOT
from tests.swarmabs_core.helpers import builtin

from swarmabs_run.simulation import simulate

FOLDER = ROOT / "examples" / "mujoco"
NAMES = ("mujoco_world", "mujoco_rig", "mujoco_sliders", "virtual_swarm", "mujoco_trial")


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """Import the modules of the example; they are forgotten after the test."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: examples/mujoco/README.md says how")
    monkeypatch.syspath_prepend(FOLDER)
    yield {name: importlib.import_module(name) for name in NAMES}
    for name in NAMES:
        del sys.modules[name]


def robot_of(example: dict[str, Any], agent: Any) -> Any:
    forced = agent.kind == "double_integrator"
    return example["mujoco_world"].Robot(agent.id, forced, agent.mass, agent.damping, agent.position)


def test_sliders_move_the_plank_as_the_robots_of_the_paper_move_the_plane(example: dict[str, Any]) -> None:
    world = example["mujoco_world"]
    scenario = builtin("pd_het_4", "duration=10")
    arrays, period = simulate(scenario), scenario.period
    bodies = [
        world.Chassis(robot_of(example, agent), agent.mass, height=0.0, base="slider") for agent in scenario.agents
    ]
    plank = world.Plank(scenario.plane.inertia, scenario.plane.length)
    physics = world.Physics(timestep=0.0005)
    friction = tuple(scenario.plane.friction)
    sliders = example["mujoco_sliders"].Sliders(bodies, plank, physics, friction, scenario.plane.angle)
    place, speed = arrays.agents.position, arrays.agents.velocity
    for step in range(scenario.steps):
        paths = []
        for number, agent in enumerate(scenario.agents):
            a, b = place[step, number], place[step + 1, number]
            if agent.kind == "single_integrator":
                paths.append((a, (b - a) / period, 0.0, 0.0))
            else:
                v, w, mean = speed[step, number], speed[step + 1, number], (b - a) / period
                paths.append((a, v, (3.0 * mean - 2.0 * v - w) / period, (v + w - 2.0 * mean) / period**2))
        angle, rate = sliders.advance(paths, period)
        assert angle == pytest.approx(arrays.angle[step + 1], abs=1e-8)
        assert rate == pytest.approx(arrays.angular_velocity[step + 1], abs=1e-7)


def test_readings_and_commands_are_as_late_as_the_rig_says(example: dict[str, Any]) -> None:
    rigs, trial = example["mujoco_rig"], example["mujoco_trial"]
    late = trial.Setup(mass_error=0.0, tilt_offset=0.0, faults=rigs.Faults(delay=0.02))
    _, rig = trial.prepare(builtin("pd_si_4"), late, 1)
    rig.drive(1, 0.2)
    for step in range(6):
        rig.advance(0.01 * step)
        assert rig.read().age == pytest.approx(min(step, 2) * 0.01)
        moved = rig.place(1) - 0.125
        assert (abs(moved) < 1e-4) == (step <= 2)
        assert rig.held == (step <= 2)


@pytest.mark.parametrize("base", ["rover", "differential"])
def test_the_swarm_follows_its_reference_with_wheels_that_it_does_not_know(example: dict[str, Any], base: str) -> None:
    trial = example["mujoco_trial"]
    result = trial.run(builtin("arise_het_4", "duration=6"), trial.Setup(base=base), 1)
    assert result.settled
    assert result.error > 1e-5 and result.farthest < 0.45 and result.steepest < 0.3


def test_a_scenario_that_is_none_is_refused(example: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert example["mujoco_trial"].main(["nowhere.yaml"]) == 2
    assert capsys.readouterr().err.startswith("error: nowhere.yaml: no such file")
