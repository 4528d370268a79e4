"""What the theory uses of a scenario."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from swarmabs_config import configure
from swarmabs_core.faults import DelayFault
from swarmabs_core.theory.setting import Setting
from swarmabs_core.theory.state_feedback import ANGLE_MAX

if TYPE_CHECKING:
    from swarmabs_config.model.scenario import AnyScenario
    from swarmabs_config.scenario import Scenario


def setting(scenario: Scenario, angle_max: float = ANGLE_MAX) -> Setting:
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
        delay=delay_of(scenario),
        faulty=bool(scenario.faults),
        angle_max=angle_max,
    )


def delay_of(scenario: AnyScenario) -> int:
    """Return the largest age, in steps, that faults give to broadcasts."""
    return max((fault.steps for fault in scenario.faults if isinstance(fault, DelayFault)), default=0)
