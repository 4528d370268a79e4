"""The rig in MuJoCo: its plank is that of the paper, its sensors are late, and the swarm levels it."""

from math import cos, sin
from typing import Any

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_core.errors import InputError
from swarmabs_run.simulation import simulate


@pytest.fixture
def example(mujoco_example: dict[str, Any]) -> dict[str, Any]:
    """Return the modules of the example by name."""
    return mujoco_example


def robot_of(example: dict[str, Any], agent: Any) -> Any:
    forced = agent.kind == "double_integrator"
    return example["mujoco_world"].Robot(agent.id, forced, agent.mass, agent.damping, agent.position)


@pytest.mark.parametrize(("height", "duration"), [(0.0, 10), (0.01, 5), (0.03, 5)])
@pytest.mark.system
def test_sliders_move_the_plank_as_the_robots_of_the_paper_move_the_plane(
    example: dict[str, Any], height: float, duration: float
) -> None:
    """Also with all masses above the axis; the velocities of single integrators jump every 10 ms."""
    world = example["mujoco_world"]
    raised = [f"swarm.agents.{n}.center_height={height}" for n in range(4)]
    plane = f"plane={{mass: 2.0, center_height: {-2.0 * height}}}"
    scenario = builtin("pd_het_4", f"duration={duration}", *raised, plane)
    arrays, period = simulate(scenario), scenario.period
    bodies = [
        world.Chassis(robot_of(example, agent), agent.mass, height=height, base="slider") for agent in scenario.agents
    ]
    plank = world.Plank(scenario.plane.inertia, scenario.plane.length, 2.0, -2.0 * height)
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
    late = example["mujoco_setup"].Setup(mass_error=0.0, tilt_offset=0.0, faults=rigs.Faults(delay=0.02))
    _, rig = trial.prepare(builtin("pd_si_4"), late, 1)
    rig.drive(1, 0.2)
    for step in range(6):
        rig.advance(0.01 * step)
        assert rig.read().time == pytest.approx(max(step - 2, 0) * 0.01)
        moved = rig.place(1) - 0.125
        assert (abs(moved) < 1e-4) == (step <= 2)
        assert rig.held == (step <= 2)


@pytest.mark.parametrize("base", ["rover", "differential"])
@pytest.mark.system
def test_the_swarm_follows_its_reference_with_wheels_that_it_does_not_know(example: dict[str, Any], base: str) -> None:
    trial = example["mujoco_trial"]
    result = trial.run(builtin("arise_het_4", "duration=6"), example["mujoco_setup"].Setup(base=base), 1)
    assert result.settled
    assert result.error > 1e-5 and result.farthest < 0.45 and result.steepest < 0.3


def test_holding_its_weight_does_not_release_the_plank(example: dict[str, Any]) -> None:
    _, rig = example["mujoco_trial"].prepare(builtin("pd_di_4"), example["mujoco_setup"].Setup(), 1)
    for robot in rig.robots.values():
        rig.drive(robot.id, robot.facing * robot.mass * rig.gravity * sin(rig.angle))
    rig.advance(0.1)
    assert rig.held and rig.angle == pytest.approx(0.1)
    robot = rig.robots[3]  # it faces against its lane
    rig.drive(3, robot.facing * robot.mass * (rig.gravity * sin(rig.angle) + 0.7))
    rig.advance(0.2)
    assert not rig.held


def test_a_disturbance_turns_the_plank_from_its_release_on(example: dict[str, Any]) -> None:
    world, rigs, torque = example["mujoco_world"], example["mujoco_rig"], 0.2
    body = world.Chassis(world.Robot(1, False, 0.5, 0.0, 0.1), 0.5)
    rates = []
    for disturbance in (lambda _: 0.0, lambda time: torque if time < 0.1 else 0.0):
        rig = rigs.MujocoRig((body,), world.Plank(), world.Physics(), (0.0,) * 6, 0.1, disturbance=disturbance)
        rig.advance(0.5)  # it is held
        rig.drive(1, 1e-6)
        rig.advance(0.6)
        rates.append(rig.rate)
    inertia = 0.5 + 0.5 * (0.1**2 + 0.03**2)
    assert rates[1] - rates[0] == pytest.approx(-torque * 0.1 / inertia, rel=0.02)


@pytest.mark.parametrize("base", ["rover", "differential"])
def test_wheels_count_the_way_forwards(example: dict[str, Any], base: str) -> None:
    setup = example["mujoco_setup"].Setup(base=base, physics=example["mujoco_world"].Physics())
    rig = example["mujoco_setup"].rig_of(builtin("pd_si_4"), setup, 1)
    for step in range(50):
        for robot in rig.robots:
            rig.drive(robot, 0.1)
        rig.advance(0.02 * step)
    for robot in rig.robots.values():
        driven = robot.facing * (rig.place(robot.id) - robot.position)
        angles = [angle for angle, _ in rig.read().robots[robot.id].wheels]
        assert len(angles) == len(rig.joints[robot.id]) == (4 if base == "rover" else 2)
        assert driven > 0.05
        for angle in angles:  # wheels slip a little, also sideways
            assert 0.02 * angle == pytest.approx(driven, abs=0.005)


@pytest.mark.parametrize("override", [None, 0.02])
@pytest.mark.parametrize("base", ["rover", "differential"])
def test_masses_are_where_the_scenario_or_an_option_says(
    example: dict[str, Any], base: str, override: float | None
) -> None:
    heights = {1: 0.05, 2: 0.03, 3: -0.01, 4: 0.03}  # 3 cm where the scenario says nothing
    given = [f"swarm.agents.{robot - 1}.center_height={heights[robot]}" for robot in (1, 3)]
    scenario = builtin("pd_si_4", *given, "plane.mass=2", "plane.center_height=-0.04")
    setup = example["mujoco_setup"].Setup(base=base, height=override, mass_error=0.0)
    rig = example["mujoco_setup"].rig_of(scenario, setup, 1)
    c, s = cos(rig.angle), sin(rig.angle)
    for robot, height in heights.items():
        body = rig.model.body(f"robot_{robot}").id
        x, _, z = rig.data.subtree_com[body]
        assert rig.model.body_subtreemass[body] == pytest.approx(scenario.agents[robot - 1].mass)
        assert c * z - s * x == pytest.approx(height if override is None else override)
    plank = rig.model.body("plane").id
    x, _, z = rig.data.xipos[plank]
    assert (c * z - s * x, rig.model.body_mass[plank]) == pytest.approx((-0.04, 2.0))
    about_axis = rig.model.body_inertia[plank][1] + 2.0 * 0.04**2
    assert about_axis == pytest.approx(scenario.plane.inertia)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["plane.angle=0.6"], "plane.angle: 0.6 rad is beyond the rig's end stops at 0.5 rad; set plane.end_stop"),
        (["plane.angular_velocity=0.1"], "plane.angular_velocity: the rig begins at rest; set it to 0"),
        (["swarm.agents.2.mass=0.045"], "robot 3: the wheels of a rover weigh 0.04 kg, so a mass of 0.045 kg is too"),
    ],
)
def test_a_scenario_that_the_rig_cannot_be_is_refused(
    example: dict[str, Any], overrides: list[str], message: str
) -> None:
    scenario = builtin("pd_si_4", *overrides)
    with pytest.raises(InputError, match=message.replace(".", r"\.")):
        example["mujoco_setup"].rig_of(scenario, example["mujoco_setup"].Setup(), 1)


def test_a_scenario_that_is_none_is_refused(example: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    assert example["mujoco_trial"].main(["nowhere.yaml"]) == 2
    assert capsys.readouterr().err.startswith("error: nowhere.yaml: no such file")
