"""Level the same plane with the paper's PD gains and with those of the LQR, in one process without ROS.

In a shell prepared by `eval "$(./scripts/swarm env)"`: python examples/compare_controllers.py
"""

from __future__ import annotations

import numpy as np

from swarmabs_run.simulation import simulate


def main() -> None:
    """Simulate both controllers and print a line for each."""
    for controller in ("pd", "lqr"):
        run = simulate("pd_het_4", {"controller": {"type": controller}, "duration": 10.0})
        level = run.summary()["settled_at"]
        torque = np.abs(run.abstract.torque).max()
        print(f"{controller:<3} settled at t = {level} s, largest torque {torque:.3f} N m")


if __name__ == "__main__":
    main()
