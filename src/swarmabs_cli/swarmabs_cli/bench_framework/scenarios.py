"""The scenarios that are measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config.scenario import load_scenario
from swarmabs_config.scenarios import builtin_scenarios

if TYPE_CHECKING:
    from swarmabs_config.scenario import Scenario

BASE = "arise_het_200"
_STEP = 0.01


def swarm_of(robots: int, steps: int) -> Scenario:
    """Return a run of so many steps with the adaptive controller and robots of both kinds, half of each.

    Parameters
    ----------
    robots : int
        At least two.
    steps : int
        At least one.
    """
    singles = robots // 2
    return load_scenario(
        builtin_scenarios()[BASE],
        (
            f"name=bench_{robots}",
            f"step={_STEP}",
            f"duration={steps * _STEP:.2f}",
            f"swarm.generate.single_integrator={singles}",
            f"swarm.generate.double_integrator={robots - singles}",
        ),
    ).resolved()


def pd_of_four(seconds: float) -> Scenario:
    """Return the built-in run of four single integrators under the PD controller, so long (s)."""
    return load_scenario(builtin_scenarios()["pd_si_4"], (f"duration={seconds:g}",)).resolved()
