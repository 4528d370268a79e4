"""Draw the flight of the payload: position, attitude and thrusts; rotor 3 fails at 10 s.

The package must be installed; the picture is written to docs/images/example_payload.png.
"""

from pathlib import Path

import matplotlib.pyplot as plt

from swarmabs_config.scenario import load_scenario
from swarmabs_run.simulation import simulate

HERE = Path(__file__).parent
ABOVE = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False, "ncols": 3}
"""Legends stand above the curves."""


def main() -> None:
    """Simulate the flight with 12 kg and with 17 kg, and draw both."""
    figure, axes = plt.subplots(3, 2, figsize=(10.0, 7.0), sharex=True, sharey="row", layout="constrained")
    for (place, angle, thrust), name in zip(axes.T, ("payload", "overloaded"), strict=True):
        run = simulate(load_scenario(HERE / f"{name}.yaml"))
        place.set_title(f"{run.description.settings['mass']:g} kg", loc="left")
        for n, axis in enumerate("xyz"):
            place.plot(run.time, run.reference[:, n], color=f"C{n}", ls="--", lw=1.0)
            place.plot(run.time, run.parent[:, n], color=f"C{n}", label=axis)
        for name_of in ("roll", "pitch", "yaw"):
            angle.plot(run.time, run[name_of], label=name_of)
        thrust.plot(run.time, run["thrust"], lw=0.7)
        thrust.set_xlabel("time, s")
        thrust.set_xlim(run.time[0], run.time[-1])
    axes[0, 0].set_ylabel("position (dashed: reference), m")
    axes[0, 1].legend(**ABOVE)
    axes[1, 0].set_ylabel("attitude, rad")
    axes[1, 1].legend(**ABOVE)
    axes[2, 0].set_ylabel("thrusts of the rotors, N")
    figure.savefig(HERE.parents[1] / "docs/images/example_payload.png", dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main()
