"""Make a film of rovers that tilt a plank: python examples/mujoco/film.py [SCENARIO] [-o FILE] [--set A.B=VALUE]."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from itertools import pairwise
from math import cos, degrees, sin
from pathlib import Path
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
from mujoco_setup import Setup
from mujoco_trial import prepare
from mujoco_world import LANE, OVERHANG
from PIL import Image, ImageDraw, ImageFont

from swarmabs_config import configure
from swarmabs_config.scenario import PlaneScenario, on_plane
from swarmabs_config.scenarios import find_scenario

RATE = 15.0
"""Frames per second."""
SIZE, STRIP = (640, 320), 80
"""Size of the view, and height of the curves below it, pixels."""
QUALITY = 45
INK, PAPER, ANGLE, WANTED = (40, 44, 52), (250, 250, 250), (0, 114, 178), (200, 30, 40)
"""Colours of text, background, angle and reference."""
_BLUE, _ORANGE = (35, 105, 185), (190, 90, 25)
_MARGIN = 46
"""Space at the left of the curves, pixels."""


def camera() -> mujoco.MjvCamera:
    """Return a view from the side, slightly from above."""
    view = mujoco.MjvCamera()
    view.lookat[:] = [0.0, 0.0, -0.06]
    view.distance, view.azimuth, view.elevation = 1.22, 80.0, -14.0
    return view


def draw_reference(scene: mujoco.MjvScene, angle: float, half: float, front: float) -> None:
    """Add a line at an angle (rad) through the axis to a scene, in front of a plank of half a length and width, m."""
    geom = scene.geoms[scene.ngeom]
    colour = np.array([*(value / 255.0 for value in WANTED), 1.0], dtype=np.float32)
    mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.zeros(9), colour)
    ends = [np.array([side * half * cos(angle), -front, side * half * sin(angle)]) for side in (-1.0, 1.0)]
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, 0.0025, *ends)
    scene.ngeom += 1


class Curves:
    """The strip below the view: angle and reference from the beginning to the present frame.

    Parameters
    ----------
    duration : float
        Length of the film, s.
    reference : callable
        Reference of the angle, rad, by time, s.
    largest : float
        Angle at the upper and lower edge, rad.
    """

    def __init__(self, duration: float, reference: Callable[[float], float], largest: float) -> None:
        self._duration, self._reference, self._largest = duration, reference, largest
        self._angles: list[tuple[float, float]] = []
        self._font = ImageFont.load_default(13)

    def drawn(self, picture: Image.Image, time: float, angle: float) -> Image.Image:
        """Return a picture of the view with the strip, and with the angle (rad) at a time (s) in words."""
        self._angles.append((time, angle))
        whole = Image.new("RGB", (SIZE[0], SIZE[1] + STRIP), PAPER)
        whole.paste(picture)
        pen = ImageDraw.Draw(whole)
        wanted = self._reference(time)
        pen.text((12, 10), f"{time:4.1f} s", INK, self._font)
        pen.text((70, 10), f"angle {degrees(angle):+5.1f}°", ANGLE, self._font)
        pen.text((170, 10), f"reference {degrees(wanted):+5.1f}°", WANTED, self._font)
        for line, (words, colour) in enumerate((("driven by velocity", _BLUE), ("driven by force", _ORANGE))):
            pen.text((SIZE[0] - 12, 10 + 18 * line), words, colour, self._font, anchor="ra")
        self._strip(pen)
        return whole

    def _strip(self, pen: ImageDraw.ImageDraw) -> None:
        pen.line([self._point(0.0, 0.0), self._point(self._duration, 0.0)], (205, 205, 205))
        for angle in (-self._largest, 0.0, self._largest):
            place = self._point(0.0, angle)
            pen.text((_MARGIN - 8, place[1]), f"{degrees(angle):.0f}°", INK, self._font, anchor="rm")
        times = np.linspace(0.0, self._duration, 200)
        self._dashed(pen, [self._point(time, self._reference(time)) for time in times])
        if len(self._angles) > 1:
            pen.line([self._point(*state) for state in self._angles], ANGLE, 2)

    @staticmethod
    def _dashed(pen: ImageDraw.ImageDraw, points: list[tuple[float, float]]) -> None:
        for begin, end in list(pairwise(points))[::2]:
            pen.line([begin, end], WANTED)

    def _point(self, time: float, angle: float) -> tuple[float, float]:
        """Return where a time, s, and an angle, rad, are in the picture."""
        width, half = SIZE[0] - _MARGIN - 14, STRIP / 2.0
        return _MARGIN + width * time / self._duration, SIZE[1] + half - (half - 12.0) * angle / self._largest


def frames(scenario: PlaneScenario, duration: float) -> list[Image.Image]:
    """Return the pictures of a trial of a duration, s."""
    swarm, rig = prepare(scenario, Setup(), seed=1)
    view, reference = camera(), configure.reference(scenario)
    times = np.arange(0.0, duration, 1.0 / RATE)
    largest = max(abs(scenario.plane.angle), *(abs(reference(time)) for time in times))
    curves = Curves(duration, reference, 1.05 * largest)
    half, front = scenario.plane.length / 2.0 + OVERHANG, len(scenario.agents) * LANE / 2.0 + 0.01
    pictures: list[Image.Image] = []
    with mujoco.Renderer(rig.model, SIZE[1], SIZE[0]) as renderer:
        while rig.time < duration:
            if rig.time >= len(pictures) / RATE:
                renderer.update_scene(rig.data, view)
                draw_reference(renderer.scene, reference(rig.time), half, front)
                pixels: Any = renderer.render()
                pictures.append(curves.drawn(Image.fromarray(pixels), rig.time, rig.angle))
            swarm.advance()
    return pictures


def main(arguments: list[str]) -> int:
    """Make the film and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scenario", nargs="?", default="arise_het_4")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, default=Path("rovers.webp"))
    parser.add_argument("--duration", type=float, default=8.0, help="length, s")
    parser.add_argument(
        "--set", action="append", default=[], metavar="A.B=VALUE", help="change a value of the scenario"
    )
    asked = parser.parse_args(arguments)
    first, *others = frames(on_plane(find_scenario(asked.scenario, asked.set), "the rig").resolved(), asked.duration)
    first.save(
        asked.output,
        save_all=True,
        append_images=others,
        duration=round(1000.0 / RATE),
        loop=0,
        quality=QUALITY,
        method=6,
    )
    print(f"{asked.output}: {asked.output.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
