"""Make a film of rovers that level a plane: python examples/mujoco/film.py [-o FILE] [SCENARIO]."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
from mujoco_setup import Setup
from mujoco_trial import prepare
from PIL import Image

from swarmabs_config.scenario import PlaneScenario, on_plane
from swarmabs_config.scenarios import find_scenario

RATE = 20.0
"""Frames per second."""
SIZE = (640, 360)
QUALITY = 40


def camera() -> mujoco.MjvCamera:
    """Return a view from the side, slightly from above."""
    found = mujoco.MjvCamera()
    found.lookat[:] = [0.0, 0.0, -0.08]
    found.distance, found.azimuth, found.elevation = 1.5, 68.0, -22.0
    return found


def frames(scenario: PlaneScenario, duration: float) -> list[Image.Image]:
    """Return the pictures of a trial of a duration, s."""
    swarm, rig = prepare(scenario, Setup(), seed=1)
    view = camera()
    pictures: list[Image.Image] = []
    with mujoco.Renderer(rig.model, SIZE[1], SIZE[0]) as renderer:
        while rig.time < duration:
            if rig.time >= len(pictures) / RATE:
                renderer.update_scene(rig.data, view)
                pictures.append(Image.fromarray(renderer.render()))
            swarm.advance()
    return pictures


def main(arguments: list[str]) -> int:
    """Make the film and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scenario", nargs="?", default="arise_het_4")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, default=Path("rovers.webp"))
    parser.add_argument("--duration", type=float, default=8.0, help="length, s")
    asked = parser.parse_args(arguments)
    first, *others = frames(on_plane(find_scenario(asked.scenario), "the rig"), asked.duration)
    first.save(
        asked.output, save_all=True, append_images=others, duration=round(1000.0 / RATE), loop=0, quality=QUALITY
    )
    print(f"{asked.output}: {asked.output.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
