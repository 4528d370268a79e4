"""Draw the plate: angles with their references, abstract state, and the paths of the robots, one of which dies.

The package must be installed; the picture is written to docs/images/example_plate.png.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from swarmabs_config.scenario import load_scenario
from swarmabs_run.simulation import simulate

HERE = Path(__file__).parent
ABOVE = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False, "ncols": 3}
"""Legends stand above the curves."""
KILLED = 4


def main() -> None:
    """Simulate the plate, and draw it."""
    run = simulate(load_scenario(HERE / "plate.yaml", [f"faults=[{{kind: kill, agent: {KILLED}, at: 15.0}}]"]))
    figure, axes = plt.subplot_mosaic(
        [["angles", "plate"], ["inertias", "plate"]], figsize=(10.0, 5.0), layout="constrained"
    )
    for n, name in enumerate(("alpha", "beta")):
        axes["angles"].plot(run.time, run.reference[:, n], color=f"C{n}", ls="--", lw=1.0)
        axes["angles"].plot(run.time, run[name], color=f"C{n}", label=name)
    axes["angles"].set_ylabel("angles (dashed: reference), rad")
    axes["angles"].legend(**ABOVE)
    for n, name in enumerate(("moment_x", "moment_y")):
        axes["inertias"].plot(run.time, run[name], color=f"C{n}", label=name)
    axes["inertias"].set_ylabel("moments of the swarm, N m")
    axes["inertias"].set_xlabel("time, s")
    axes["inertias"].legend(**ABOVE)
    x, y = run["x"], run["y"]
    axes["plate"].plot(x, y, lw=0.6)
    axes["plate"].scatter(x[0], y[0], s=12.0, color="k", zorder=3, label="at 0 s")
    last = 1500
    axes["plate"].plot(*((v[last, KILLED - 1]) for v in (x, y)), "rx", ms=10.0, label=f"robot {KILLED} from 15 s on")
    axes["plate"].set_aspect("equal")
    axes["plate"].set_xlabel("x, m")
    axes["plate"].set_ylabel("y, m")
    axes["plate"].legend(**ABOVE)
    figure.savefig(HERE.parents[1] / "docs/images/example_plate.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main()
