"""Draw the ship with and without the swarm: roll angle, requested and exerted moment, trolleys.

The package must be installed; the picture is written to docs/images/example_ship.png.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from swarmabs_config.scenario import load_scenario
from swarmabs_run.simulation import simulate

HERE = Path(__file__).parent
ABOVE = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False, "ncols": 3}
"""Legends stand above the curves."""


def main() -> None:
    """Simulate both, and draw them."""
    run = simulate(load_scenario(HERE / "ship.yaml"))
    alone = simulate(load_scenario(HERE / "ship.yaml", ["system.rate_gain=0", "system.estimator=0"]))
    figure, (roll, moment, position) = plt.subplots(3, 1, figsize=(8.0, 7.0), sharex=True, layout="constrained")
    roll.plot(alone.time, alone["roll"], color="0.6", label="trolleys at rest")
    roll.plot(run.time, run["roll"], color="C0", label="trolleys in motion")
    roll.set_ylabel("roll angle, rad")
    roll.legend(**ABOVE)
    moment.plot(run.time, run.desired.value[:, 0] / 1e3, color="C1", lw=3.0, label="requested")
    moment.plot(run.time, run["moment"] / 1e3, color="k", lw=1.0, label="exerted")
    moment.set_ylabel("moment, kN m")
    moment.legend(**ABOVE)
    position.plot(run.time, run["position"], lw=0.8)
    position.set_ylabel("positions of the trolleys, m")
    position.set_xlabel("time, s")
    position.set_xlim(run.time[0], run.time[-1])
    figure.savefig(HERE.parents[1] / "docs/images/example_ship.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main()
