"""Level the same plane with the paper's PD gains and with those of the LQR, in one process without ROS.

In a shell prepared by `eval "$(./scripts/swarm env)"`: python examples/compare_controllers.py
"""

from __future__ import annotations

import numpy as np

from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulation import simulate

BAND = 0.01
"""Angle, rad, below which the plane counts as level."""


def main() -> None:
    """Simulate both and print a line each."""
    for controller in ("{type: pd}", "{type: lqr}"):
        run = simulate(find_scenario("pd_het_4", [f"controller={controller}", "duration=10.0"]))
        outside = np.flatnonzero(np.abs(run.angle) >= BAND)
        level = run.time[outside[-1] + 1] if outside[-1] + 1 < len(run.time) else np.inf
        torque = np.abs(run.abstract.torque).max()
        print(f"{controller:<12} level from {level:5.2f} s on, largest torque {torque:.3f} N m")


if __name__ == "__main__":
    main()
