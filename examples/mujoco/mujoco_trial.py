"""Trials: the nodes of a scenario on a rig that differs from what they know.

python examples/mujoco/mujoco_trial.py [SCENARIO] [--seeds N] [--height M] [--mass-error SHARE] [--base BASE]
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, NamedTuple

from mujoco_setup import BASES, Setup, rig_of
from virtual_swarm import State, Swarm

from swarmabs_config import configure
from swarmabs_config.scenario import on_plane
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from mujoco_rig import MujocoRig

    from swarmabs_config.scenario import PlaneScenario

LAST = 2.0
"""Time at the end of a trial over which its error is taken, s."""
SETTLED = 0.02
"""Largest error in that time of a trial that has settled, rad."""


class Result(NamedTuple):
    """What a trial has shown.

    Attributes
    ----------
    error : float
        Largest error of the angle in the last `LAST` seconds, rad.
    farthest : float
        Largest distance of a robot from the axis, m.
    steepest : float
        Largest angle, rad.
    """

    error: float
    farthest: float
    steepest: float

    @property
    def settled(self) -> bool:
        """Whether the plane follows its reference at the end."""
        return self.error <= SETTLED


def prepare(scenario: PlaneScenario, setup: Setup, seed: int) -> tuple[Swarm, MujocoRig]:
    """Return a swarm and its rig; masses and the offset of the encoder are drawn by the seed."""
    rig = rig_of(scenario, setup, seed)
    return Swarm(scenario, rig), rig


def run(scenario: PlaneScenario, setup: Setup, seed: int) -> Result:
    """Run a trial to the end of its scenario."""
    swarm, _ = prepare(scenario, setup, seed)
    return judged(scenario, [swarm.advance() for _ in range(scenario.steps)])


def judged(scenario: PlaneScenario, states: list[State]) -> Result:
    """Return the result of a trial with these states."""
    reference = configure.reference(scenario)
    end = states[-1].time - LAST
    return Result(
        max(abs(state.angle - reference(state.time)) for state in states if state.time > end),
        max(abs(place) for state in states for place in state.places),
        max(abs(state.angle) for state in states),
    )


def main(arguments: list[str]) -> int:
    """Run trials, print their results, and return the exit code: 1 if one has not settled."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scenario", nargs="?", default="arise_het_4", help="built-in scenario or YAML file")
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="number of trials")
    parser.add_argument(
        "--height",
        type=float,
        metavar="M",
        help="of the centres of mass, m; default: that of the scenario, 0.03 where it is 0",
    )
    parser.add_argument("--mass-error", type=float, default=0.15, metavar="SHARE", help="largest error of the masses")
    parser.add_argument("--base", choices=BASES, default="rover", help="base of the robots")
    parser.add_argument("--duration", type=float, default=10.0, help="of a trial, s")
    asked = parser.parse_args(arguments)
    setup = Setup(base=asked.base, height=asked.height, mass_error=asked.mass_error)
    try:
        scenario = on_plane(find_scenario(asked.scenario, [f"duration={asked.duration}"]), "the rig")
    except InputError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    settled = 0
    for seed in range(1, asked.seeds + 1):
        result = run(scenario, setup, seed)
        settled += result.settled
        print(
            f"seed {seed}: {'settled' if result.settled else 'NOT settled'}, error {result.error:.4f} rad in the last "
            f"{LAST:g} s, farthest robot {result.farthest:.3f} m from the axis"
        )
    print(f"{settled} of {asked.seeds} settled")
    return 0 if settled == asked.seeds else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
