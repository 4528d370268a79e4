"""Calibrate robots and plane from measurements: python examples/build_one/calibrate.py METHOD --help.

Each method prints the values under the names that they have in the scenario (plane.*), in the fleet file, or as a
setting of a drive or of `plane_driver`.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median
from typing import NamedTuple

import numpy as np
from swarmabs_serial_base import BAUDS, UNPLACED, Odometry, SerialBase

from swarmabs_core.errors import InputError, RunError

GRAVITY = 9.81  # m/s^2, the scenario's default
TOP = 0.9
"""Share of a turning point's height above which samples are fitted."""
FEWEST = 5
"""Fewest turning points of a usable record: two unknowns from the widths of the swings between them."""
STEADY = 0.01
"""Relative decay of the swings in a record below which it does not tell the kinds of friction apart."""
STANDING = 1000
"""Speed below which a robot stands, um/s."""
PATIENCE = 0.5
"""Longest wait for a base, s."""


class Swing(NamedTuple):
    """A free oscillation of the plank.

    Attributes
    ----------
    frequency : float
        Angular frequency without friction and at small amplitude, rad/s.
    decay : float
        Rate at which viscous friction lets the amplitude decay, 1/s.
    dead_angle : float
        Angle from the equilibrium at which Coulomb friction holds the plank, rad.
    """

    frequency: float
    decay: float
    dead_angle: float


class Plank(NamedTuple):
    """Moment of inertia, kg m^2; mass times height of its centre above the axis, kg m; friction, N m and N m s/rad."""

    inertia: float
    moment: float
    coulomb: float
    viscous: float


def swing(times: list[float], angles: list[float]) -> Swing:
    """Return what a record of angles (rad) over times (s) shows, from the release or later.

    From one turning point to the next the plank moves harmonically about the equilibrium shifted by the dead angle c
    against the motion, so that every half period is the same, and the widths of two consecutive swings fulfil
    d' = r d - 2 c (1 + r) with r = exp(-decay T/2). The width contains neither the equilibrium nor the sensor's offset.

    Raises
    ------
    InputError
        If there are too few turning points, or the amplitude does not decay.
    """
    turns = turning_points(np.array(times), np.array(angles))
    if len(turns) < FEWEST:
        raise InputError(
            f"the record has {len(turns)} turning points instead of {FEWEST} at least",
            "record longer, hang the mass lower, or reduce the friction",
        )
    half_period = (turns[-1][0] - turns[0][0]) / (len(turns) - 1)
    widths = np.abs(np.diff([angle for _, angle in turns]))
    before, after = widths[:-1], widths[1:]
    spread = np.ptp(before) > STEADY * before.mean()
    ratio, constant = np.polyfit(before, after, 1) if spread else (0.0, 1.0)
    if constant > 0.0:  # more noise than Coulomb friction
        ratio, constant = before @ after / (before @ before), 0.0
    if not ratio > 0.0:
        raise InputError("the swings do not decay regularly", "record a free oscillation of the plank alone")
    decay = max(0.0, -math.log(ratio) / half_period)
    amplitude_squared = fmean(widths**2) / 4.0
    frequency = math.hypot(math.pi / half_period, decay) * (1.0 + amplitude_squared / 16.0)
    return Swing(frequency, decay, -constant / (2.0 * (1.0 + ratio)))


def turning_points(times: np.ndarray, angles: np.ndarray) -> list[tuple[float, float]]:
    """Return times (s) and angles (rad) of the turning points between two crossings of the middle."""
    around = angles - (angles.max() + angles.min()) / 2.0
    dead = 0.1 * np.abs(around).max()
    sides = [(index, around[index] > 0.0) for index in np.flatnonzero(np.abs(around) > dead)]
    starts = [place for place, side in enumerate(sides) if place and side[1] != sides[place - 1][1]]
    turns = []
    for start, end in pairwise(starts):
        section = slice(sides[start][0], sides[end - 1][0] + 1)
        t, x = times[section], around[section]
        top = np.abs(x) >= TOP * np.abs(x).max()
        if top.sum() < 3:
            break
        a, b, c = np.polyfit(t[top] - t[0], x[top], 2)
        at = -b / (2.0 * a)
        turns.append((float(t[0] + at), float(c + b * at / 2.0)))
    return turns


def plank(swings: list[tuple[Swing, float, float]], gravity: float = GRAVITY) -> Plank:
    """Return the plank from its oscillations with a mass (kg) at a distance (m) below the axis, each a tuple.

    J + m d^2 times the squared frequency is m g d - g H: linear in J and H.

    Raises
    ------
    InputError
        If the oscillations do not determine both.
    """
    rows = np.array([[each.frequency**2, gravity] for each, _, _ in swings])
    right = np.array([m * d * (gravity - d * each.frequency**2) for each, m, d in swings])
    if len({(m, d) for _, m, d in swings}) < 2:
        raise InputError(
            "one mass at one distance does not tell the inertia from the height", "record another distance"
        )
    (inertia, moment), *_ = np.linalg.lstsq(rows, right, rcond=None)
    loaded = [(each, inertia + m * d * d) for each, m, d in swings]
    coulomb = fmean(each.dead_angle * total * each.frequency**2 for each, total in loaded)
    return Plank(float(inertia), float(moment), coulomb, fmean(2.0 * each.decay * total for each, total in loaded))


def balance(known: float, place: float, inner: float, outer: float, gravity: float = GRAVITY) -> tuple[float, float]:
    """Return the mass (kg) of a robot, and the friction of the bearing at rest, N m.

    Parameters
    ----------
    known : float
        Mass that is moved on the other side of the axis, kg.
    place : float
        Distance of the robot from the axis, m.
    inner, outer : float
        Distances of the mass, m, at which the plank leaves the level towards the robot and towards the mass.
    gravity : float
        m/s^2.
    """
    return known * (inner + outer) / (2.0 * place), known * gravity * (outer - inner) / 2.0


def centre(wheelbase: float, forwards: float, backwards: float) -> tuple[float, float]:
    """Return the height (m) of a robot's centre of mass above the surface, and its place behind the front contact, m.

    Parameters
    ----------
    wheelbase : float
        Distance of the front and rear points of contact, m.
    forwards, backwards : float
        Slopes, rad, at which it tips over its front and its rear points of contact.
    """
    height = wheelbase / (math.tan(forwards) + math.tan(backwards))
    return height, height * math.tan(forwards)


def offset(first: float, second: float) -> tuple[float, float]:
    """Return the offset of the plane's sensor, and the error of the level, both rad.

    The readings are those at which the level shows 0, before and after it was turned end for end.
    """
    return -(first + second) / 2.0, (first - second) / 2.0


def scale(distance: float, counted: list[float]) -> float:
    """Return the true distance (m) over the mean of the counted ones, of drives in both directions."""
    return abs(distance) / fmean(map(abs, counted))


def record(device: str, baud: str, duration: float) -> list[tuple[float, float, float]]:
    """Return time (s), position (m; of the plane rad) and velocity that a base measures for a time, s.

    Raises
    ------
    InputError, RunError
        If the device cannot be used, nothing arrives, or the base is not on its mark.
    """
    base = SerialBase(device, baud)
    rows: list[tuple[float, float, float]] = []
    try:
        answers = _answers(base, 0, device)
        start = answers[0].time
        while not rows or rows[-1][0] < duration:
            rows += [((a.time - start) % 2**32 / 1e6, a.position / 1e6, a.velocity / 1e6) for a in answers]
            answers = _answers(base, 0, device)
    finally:
        base.close()
    return rows


def drive(device: str, baud: str, speed: float, duration: float) -> float:
    """Let a robot drive at a speed (m/s) for a time (s) of its board; return the distance that it counts, m.

    Raises
    ------
    InputError, RunError
        If the device cannot be used, does not answer, or the base is not on its mark.
    """
    base = SerialBase(device, baud)
    try:
        first = last = _answers(base, 0, device)[-1]
        while (last.time - first.time) % 2**32 < duration * 1e6:
            last = _answers(base, round(speed * 1e6), device)[-1]
        while abs(last.velocity) > STANDING:
            last = _answers(base, 0, device)[-1]
    finally:
        base.close()
    return (last.position - first.position) / 1e6


def _answers(base: SerialBase, velocity: int, device: str) -> list[Odometry]:
    """Command a velocity, um/s, and return what the base answers until now, at least once."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        base.command(velocity, time.time_ns())
        base.wait(PATIENCE)
        answers = base.received()
        if any(answer.state == UNPLACED for answer in answers):
            raise RunError("the base is not on its mark", "put it there, press its button, and try again")
        if answers:
            return answers
    raise RunError(f"nothing was received from {device}", "check its rate and its firmware")


def delays(device: str, baud: str, count: int) -> list[float]:
    """Return the times, s, that commands and the answers to them were on their way together.

    Raises
    ------
    InputError, RunError
        If the device cannot be used, or does not answer.
    """
    base = SerialBase(device, baud)
    passed: list[float] = []
    try:
        while len(passed) < count:
            sent = time.time_ns()
            base.command(0, sent)
            passed.append(_answered(base, sent, device))
    finally:
        base.close()
    return passed


def _answered(base: SerialBase, sent: int, device: str) -> float:
    while time.time_ns() < sent + PATIENCE * 1e9:
        base.wait(PATIENCE)
        for answer in base.received():
            if answer.number == sent // 1_000_000 % 2**32:
                return (time.time_ns() - sent - answer.since * 1000) / 1e9
    raise RunError(f"{device} does not answer commands", "check its rate, both wires and its firmware")


def read_record(path: Path) -> Swing:
    """Return the swing that a file of `record` contains.

    Raises
    ------
    InputError
        If it cannot be read, or shows no usable oscillation.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = [(float(row["time"]), float(row["position"])) for row in csv.DictReader(file)]
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: no record with time and position ({error})", "make it with: record") from error
    try:
        return swing([time for time, _ in rows], [angle for _, angle in rows])
    except InputError as error:
        raise InputError(f"{path}: {error.problem}", error.remedy) from error


def _record(asked: argparse.Namespace) -> None:
    rows = record(asked.device, asked.baud, asked.duration)
    with asked.output.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("time", "position", "velocity"))
        writer.writerows(rows)
    print(f"{len(rows)} readings in {rows[-1][0]:.1f} s: {asked.output}")


def _drive(asked: argparse.Namespace) -> None:
    print(f"counted: {drive(asked.device, asked.baud, asked.speed, asked.duration):.4f} m")


def _delay(asked: argparse.Namespace) -> None:
    passed = delays(asked.device, asked.baud, asked.count)
    print(f"delay of command and answer together: {1e3 * median(passed):.1f} ms, at most {1e3 * max(passed):.1f} ms")


def _swing(asked: argparse.Namespace) -> None:
    try:
        given = [(Path(file), float(mass), float(distance)) for file, mass, distance in asked.swing]
    except ValueError as error:
        raise InputError(f"--swing: {error}", "give FILE MASS DISTANCE, in kg and m") from error
    found = plank([(read_record(file), mass, distance) for file, mass, distance in given], asked.gravity)
    print(f"plane.inertia: {found.inertia:.4f}     # kg m^2")
    print(f"plane.friction: [0, 1000, 700, {found.coulomb:.4f}, 1000, {found.viscous:.4f}]")
    print(f"mass of the plank times height of its centre above the axis: {found.moment:.4f} kg m")


def _balance(asked: argparse.Namespace) -> None:
    mass, friction = balance(asked.known, asked.place, asked.inner, asked.outer, asked.gravity)
    print(f"robots[].mass: {mass:.4f}     # kg, +- {friction / asked.gravity / asked.place:.4f}")
    print(f"friction at rest: {friction:.4f} N m")


def _centre(asked: argparse.Namespace) -> None:
    height, behind = centre(asked.wheelbase, math.radians(asked.forwards), math.radians(asked.backwards))
    print(f"centre of mass: {height:.4f} m above the surface, {behind:.4f} m behind the front contact")


def _offset(asked: argparse.Namespace) -> None:
    sensor, level = offset(asked.first, asked.second)
    print(f"offset: {sensor:.5f}     # rad, of plane_driver\nerror of the level: {level:.5f} rad")


def _scale(asked: argparse.Namespace) -> None:
    print(f"scale: {scale(asked.distance, asked.counted):.5f}     # of the drive")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    methods = parser.add_subparsers(metavar="METHOD", required=True)

    def method(name: str, text: str, call: Callable[[argparse.Namespace], None]) -> argparse.ArgumentParser:
        added = methods.add_parser(name, help=text, description=text)
        added.set_defaults(call=call)
        return added

    def number(parser: argparse.ArgumentParser, name: str, text: str) -> None:
        parser.add_argument(f"--{name}", type=_positive, required=True, help=text)

    def serial(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("device", help="serial device, such as /dev/ttyACM0")
        parser.add_argument("--baud", choices=BAUDS, default="230400")

    recording = method("record", "write what a base measures to a file", _record)
    serial(recording)
    recording.add_argument("-o", "--output", type=Path, required=True, metavar="FILE")
    recording.add_argument("--duration", type=_positive, default=20.0, help="s")
    driving = method("drive", "let a robot drive and print the distance that it counts", _drive)
    serial(driving)
    driving.add_argument("--speed", type=float, default=0.1, help="m/s, negative backwards")
    driving.add_argument("--duration", type=_positive, default=6.0, help="s")
    delay = method("delay", "measure the delay of the serial line", _delay)
    serial(delay)
    delay.add_argument("--count", type=int, default=200, help="number of commands")
    swinging = method("swing", "inertia, friction and height of the plank from its swings with a hanging mass", _swing)
    form = ("FILE", "MASS", "DISTANCE")
    swinging.add_argument("--swing", nargs=3, action="append", required=True, metavar=form, help="of a record; kg, m")
    balancing = method("balance", "mass of a robot that balances a mass", _balance)
    number(balancing, "known", "mass on the other side, kg")
    number(balancing, "place", "distance of the robot from the axis, m")
    number(balancing, "inner", "distance of the mass at which the plank leaves the level towards the robot, m")
    number(balancing, "outer", "distance of the mass at which the plank leaves the level towards the mass, m")
    for added in (swinging, balancing):
        added.add_argument("--gravity", type=_positive, default=GRAVITY, help="m/s^2")
    tipping = method("centre", "centre of mass of a robot from the slopes at which it tips", _centre)
    number(tipping, "wheelbase", "distance of the front and rear points of contact, m")
    number(tipping, "forwards", "slope at which it tips over the front, degrees")
    number(tipping, "backwards", "slope at which it tips over the rear, degrees")
    levelling = method("offset", "offset of the plane's sensor from a level that is turned end for end", _offset)
    levelling.add_argument("--first", type=float, required=True, help="reading when the level shows 0, rad")
    levelling.add_argument("--second", type=float, required=True, help="the same after it was turned, rad")
    scaling = method("scale", "scale of a wheel from drives along the lane", _scale)
    number(scaling, "distance", "true distance, m")
    scaling.add_argument("--counted", type=float, nargs="+", required=True, help="counted distances, m")
    return parser


def _positive(text: str) -> float:
    value = float(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is not positive")
    return value


def main(arguments: list[str]) -> int:
    """Run a method and return the exit code."""
    asked = _parser().parse_args(arguments)
    try:
        asked.call(asked)
    except (InputError, RunError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2 if isinstance(error, InputError) else 1
    except OSError as error:
        sys.stderr.write(f"error: {error.filename}: {error.strerror}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
