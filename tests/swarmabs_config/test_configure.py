from __future__ import annotations

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_config import configure
from swarmabs_core.behaviours import LifeSpan, Limits
from swarmabs_core.controllers import Arise, StateFeedback, lqr_gains
from swarmabs_core.faults import DelayFault, InjectedFault, LieFault, LossFault
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import Kind
from swarmabs_core.swarm_law import SwarmGains

FAULTS = (
    "faults=[{at: 0.5, kind: kill, agent: 3}, {at: 0.2, kind: join, agent: 2}, {at: 0.4, kind: leave, agent: 2}, "
    "{kind: loss, probability: 0.25}, {kind: delay, steps: 2, agents: [1, 4]}, "
    "{kind: lie, agent: 2, position_offset: 0.01, from: 0.104, to: 0.301}]"
)


def test_schedule_holds_the_changes_of_membership_by_step() -> None:
    assert configure.schedule(builtin("pd_het_4", FAULTS)) == (
        Change(20, 2, ChangeKind.JOIN),
        Change(40, 2, ChangeKind.LEAVE),
        Change(50, 3, ChangeKind.KILL),
    )


def test_observer_plane_and_controller() -> None:
    scenario = builtin("arise_het_4", "step=0.005", "duration=1", "plane.gravity=9.8", "swarm.gains.ksd=1.5", FAULTS)
    observer, plane = configure.observer_config(scenario), configure.plane_config(scenario)
    controller = configure.controller_config(scenario, recording_window=100)
    assert observer.members == plane.members == (1, 2, 3, 4)
    assert observer.schedule == plane.schedule == configure.schedule(scenario)
    assert observer.gravity == plane.plane.gravity == 9.8
    assert observer.ksd == 1.5
    assert {c.period_ns for c in (observer, plane, controller)} == {5_000_000}
    assert {c.last_step for c in (observer, plane, controller)} == {200}
    assert plane.plane == scenario.plane
    assert (plane.plane.angle, plane.plane.disturbance.amplitude, plane.plane.friction.g3) == (0.075, 0.1, 700.0)
    assert (controller.manifold.curvature, controller.recording_window) == (0.0125, 100)


def test_robots() -> None:
    gains = "swarm.gains={k: [1, 2], kp: [3, 4], kd: [5, 6], ksd: 7}"
    robots = configure.agent_configs(builtin("pd_het_4", gains, "limits.force=2.5", "seed=9", FAULTS))
    assert [robot.agent_id for robot in robots] == [1, 2, 3, 4]
    assert [robot.kind for robot in robots] == [Kind.SINGLE_INTEGRATOR] * 2 + [Kind.DOUBLE_INTEGRATOR] * 2
    assert [robot.damping for robot in robots] == [0.0, 0.0, 0.6524, 1.3258]
    assert [robot.life for robot in robots] == [
        LifeSpan(),
        LifeSpan(20, ChangeKind.LEAVE, 40),
        LifeSpan(0, ChangeKind.KILL, 50),
        LifeSpan(),
    ]
    for robot in robots:
        assert robot.gains == SwarmGains((1.0, 2.0), (3.0, 4.0), (5.0, 6.0), 7.0)
        assert robot.limits == Limits(force=2.5)
        assert robot.seed == 9
    loss, delay = InjectedFault(LossFault(probability=0.25)), InjectedFault(DelayFault(steps=2))
    lie = InjectedFault(LieFault(position_offset=0.01), 10, 30)
    assert [robot.faults for robot in robots] == [(loss, delay), (loss, lie), (loss,), (loss, delay)]


def test_robot_that_is_there_for_one_step() -> None:
    faults = "faults=[{at: 0, kind: freeze, agent: 2}, {at: 0, kind: join, agent: 2}]"
    assert configure.agent_configs(builtin("pd_het_4", faults))[1].life == LifeSpan(0, ChangeKind.FREEZE, 0)


def test_generated_swarm_is_drawn_out() -> None:
    robots = configure.agent_configs(builtin("arise_het_20"))
    assert len(robots) == 20
    assert [robot.position for robot in robots[:3]] == [0.125, -0.125, 0.125]


@pytest.mark.parametrize("robot_gravity", ["true", "false"])
def test_robots_feel_gravity_as_the_scenario_says(robot_gravity: str) -> None:
    robots = configure.agent_configs(builtin("pd_di_4", f"plane.robot_gravity={robot_gravity}"))
    assert {robot.feels_gravity for robot in robots} == {robot_gravity == "true"}


def test_control_laws() -> None:
    assert configure.parent_controller(builtin("pd_si_4")) == StateFeedback(3.1623, 3.2859)
    law = configure.parent_controller(builtin("pd_si_4", "controller={type: lqr, q: [4, 2], r: 3}"))
    assert law == StateFeedback(*lqr_gains((4.0, 2.0), 3.0, 0.525, 1.0))
    assert isinstance(configure.parent_controller(builtin("arise_si_4")), Arise)


def test_nested_settings_are_joined_by_dots() -> None:
    settings = configure.controller_settings(
        builtin("arise_si_4", "controller.trajectory={type: constant, angle: 0.2}")
    )
    assert settings["trajectory.type"] == "constant"
    assert settings["trajectory.angle"] == 0.2
    assert (
        configure.parent_controller(
            builtin("arise_si_4", "controller.trajectory={type: constant, angle: 0.2}")
        ).reference(3.0)
        == 0.2
    )


@pytest.mark.parametrize(("robots", "window"), [(4, 100), (200, 100), (1000, 20), (2000, 10), (20_000, 4)])
def test_a_large_swarm_is_fewer_steps_ahead_of_its_recorder(robots: int, window: int) -> None:
    kinds = ("single_integrator", "double_integrator")
    halves = [f"swarm.generate.{kind}={robots // 2}" for kind in kinds]
    assert configure.recording_window(builtin("arise_het_200", *halves)) == window
