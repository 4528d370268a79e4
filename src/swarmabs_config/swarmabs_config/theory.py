"""Apply the theory to a scenario."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_config.scenario import PlaneScenario
from swarmabs_core.faults import DelayFault
from swarmabs_core.theory.check import check, warnings
from swarmabs_core.theory.setting import Setting
from swarmabs_core.theory.state_feedback import ANGLE_MAX, Estimate, estimate
from swarmabs_core.theory.systems import SystemSetting, check_system

if TYPE_CHECKING:
    from swarmabs_config.model.scenario import Scenario, SystemScenario
    from swarmabs_core.theory.report import Report


class _PlaneTheory:
    """The theorems and conditions for runs on the plane."""

    def __init__(self, scenario: PlaneScenario, angle_max: float) -> None:
        self._setting = setting(scenario, angle_max)

    def report(self) -> Report:
        return check(self._setting)

    def warnings(self) -> tuple[str, ...]:
        return tuple(warnings(self._setting))

    def attraction(self) -> Estimate | None:
        return estimate(self._setting)


class _SystemTheory:
    """The conditions for runs on another parent system, which no theorem is about."""

    def __init__(self, scenario: SystemScenario) -> None:
        self._scenario = scenario

    def report(self) -> Report:
        scenario = self._scenario
        robots = tuple(robot for robot in configure.agent_configs(scenario) if robot.life.first_step == 0)
        faulty = bool(scenario.faults) or not scenario.sensor.perfect
        return check_system(SystemSetting(scenario.name, robots, _delay(scenario), faulty, scenario.requests))

    def warnings(self) -> tuple[str, ...]:
        return ()

    def attraction(self) -> None:
        return None


def _theory(scenario: Scenario, angle_max: float = ANGLE_MAX) -> _PlaneTheory | _SystemTheory:
    return _PlaneTheory(scenario, angle_max) if isinstance(scenario, PlaneScenario) else _SystemTheory(scenario)


def check_scenario(scenario: Scenario, angle_max: float = ANGLE_MAX) -> Report:
    """Evaluate the paper's theorems and further conditions for sampled time; the bound is that of `setting`."""
    return _theory(scenario, angle_max).report()


def theory_warnings(scenario: Scenario) -> tuple[str, ...]:
    """Return the warnings that follow from the theory, which covers runs on the plane."""
    return _theory(scenario).warnings()


def attraction(scenario: Scenario, angle_max: float) -> Estimate | None:
    """Return the estimates of the region of attraction; None if no theorem has any; the bound is as in `setting`."""
    return _theory(scenario, angle_max).attraction()


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
        heights={agent.id: agent.center_height for agent in scenario.agents},
        compensated=configure.parent_law(scenario).compensated,
        faulty=bool(scenario.faults),
        angle_max=angle_max,
    )


def _delay(scenario: Scenario) -> int:
    """Return the largest age, in steps, that faults give to broadcasts."""
    return max((fault.steps for fault in scenario.faults if isinstance(fault, DelayFault)), default=0)
