"""Apply the theory to a scenario."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_config.scenario import PlaneScenario, SystemScenario
from swarmabs_core.faults import DelayFault
from swarmabs_core.theory.check import check, warnings
from swarmabs_core.theory.setting import Setting
from swarmabs_core.theory.state_feedback import ANGLE_MAX, Estimate, estimate
from swarmabs_core.theory.systems import SystemSetting, check_system

if TYPE_CHECKING:
    from swarmabs_config.model.scenario import Scenario
    from swarmabs_core.theory.report import Report


def check_scenario(scenario: Scenario, angle_max: float = ANGLE_MAX) -> Report:
    """Evaluate the paper's theorems and further conditions for sampled time; the bound is that of `setting`."""
    if isinstance(scenario, PlaneScenario):
        return check(setting(scenario, angle_max))
    assert isinstance(scenario, SystemScenario)  # noqa: S101 - there are two kinds
    robots = tuple(robot for robot in configure.agent_configs(scenario) if robot.life.first_step == 0)
    faulty = bool(scenario.faults) or not scenario.sensor.perfect
    return check_system(SystemSetting(scenario.name, robots, _delay(scenario), faulty, scenario.requests))


def theory_warnings(scenario: Scenario) -> tuple[str, ...]:
    """Return the warnings that follow from the theory, which covers runs on the plane."""
    return tuple(warnings(setting(scenario))) if isinstance(scenario, PlaneScenario) else ()


def attraction(scenario: Scenario, angle_max: float) -> Estimate | None:
    """Return the estimates of the region of attraction; None if no theorem has any; the bound is as in `setting`."""
    return estimate(setting(scenario, angle_max)) if isinstance(scenario, PlaneScenario) else None


def setting(scenario: PlaneScenario, angle_max: float = ANGLE_MAX) -> Setting:
    """Return the quantities of a scenario that the theory uses, such as its initial state and gains.

    The bound `angle_max` (rad, below pi/2) is theta_max of the theorems of state feedback.
    """
    return Setting(
        scenario=scenario.name,
        controller=scenario.controller.type,
        make_law=partial(configure.parent_controller, scenario),
        manifold=scenario.manifold,
        plane=scenario.plane,
        period=scenario.period,
        robots=configure.agent_configs(scenario),
        duration=scenario.duration,
        delay=_delay(scenario),
        faulty=bool(scenario.faults),
        angle_max=angle_max,
    )


def _delay(scenario: Scenario) -> int:
    """Return the largest age, in steps, that faults give to broadcasts."""
    return max((fault.steps for fault in scenario.faults if isinstance(fault, DelayFault)), default=0)
