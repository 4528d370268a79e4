"""Apply the theory to a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_config.scenario import Scenario, SystemScenario
from swarmabs_config.theory_setting import delay_of, setting
from swarmabs_core.theory.check import check
from swarmabs_core.theory.state_feedback import ANGLE_MAX
from swarmabs_core.theory.systems import SystemSetting, check_system

if TYPE_CHECKING:
    from swarmabs_config.model.scenario import AnyScenario
    from swarmabs_core.theory.report import Report


def check_scenario(scenario: AnyScenario, angle_max: float = ANGLE_MAX) -> Report:
    """Evaluate the paper's theorems and further conditions for sampled time; the bound is that of `setting`."""
    if isinstance(scenario, Scenario):
        return check(setting(scenario, angle_max))
    assert isinstance(scenario, SystemScenario)  # noqa: S101 - there are two kinds
    robots = tuple(robot for robot in configure.agent_configs(scenario) if robot.life.first_step == 0)
    faulty = bool(scenario.faults) or not scenario.sensor.perfect
    return check_system(SystemSetting(scenario.name, robots, delay_of(scenario), faulty, scenario.requests))
