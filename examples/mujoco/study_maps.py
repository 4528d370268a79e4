"""The maps of the study: growing imperfections, one at a time, and the closed loops that meet them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from mujoco_rig import Faults
from mujoco_setup import FAULTS, GRIPPING, HEIGHT, Setup
from study_trials import Deviation, Loop

from swarmabs_core.plant import Friction, Plane

if TYPE_CHECKING:
    from collections.abc import Callable

PHYSICS = replace(GRIPPING, timestep=0.0025)
"""Time step with which a trial takes half the time; the error in the last 2 s differs by 0.0003 rad."""
SEEDED = Setup(height=HEIGHT, physics=PHYSICS)
"""The rig of the trials by seed: 15 % of mass error, encoder offset up to 0.005 rad."""
CALIBRATED = replace(SEEDED, mass_error=0.05, tilt_offset=0.002)
"""The rig of the maps, but for what grows: robots were weighed, and the encoder was set to 0 on the level plane."""

_LEVEL = ("plane.angle=0.1", "plane.disturbance.amplitude=0")
ARISE = Loop("ARISE, reference")
LEVELLING = Loop("ARISE", (*_LEVEL, "controller={type: arise, trajectory: {type: constant}}"))
PD = Loop("PD", (*_LEVEL, "controller={type: pd}"))
LQR = Loop("LQR", (*_LEVEL, "controller={type: lqr}"))
PID = Loop("PID", (*_LEVEL, "controller={type: pid}"))
ESTIMATED = Loop("LQR, torque estimated", LQR.changes, bandwidth=50.0)
NARROW = Loop("LQR, narrow manifold", (*LQR.changes, "manifold.offset=0.0125"))
COMPARED = (PD, LQR, PID, LEVELLING, ESTIMATED)
"""Loops on every map."""
DAMPED = Loop("LQR, k_sd = 5", (*LQR.changes, "swarm.gains.ksd=5"))
COMPENSATED = Loop("LQR, height compensated", LQR.changes, compensated=True)
PRINTED = Loop("ARISE as printed", (*ARISE.changes, "swarm.law={type: printed}"))
MANY, FEW = 100, 10
"""Seeds of loops that should settle on any rig, and of those to compare them with."""
BY_SEED = {ARISE: MANY, PID: MANY, PD: FEW, LQR: FEW, ESTIMATED: FEW, DAMPED: FEW, COMPENSATED: FEW, PRINTED: FEW}
"""Number of seeds by loop."""


@dataclass(frozen=True)
class Map:
    """An imperfection that grows.

    Attributes
    ----------
    name : str
        As the command, tables and files name it.
    label : str
        Of the axis in figures, with unit.
    values : tuple of float
        Sizes of the imperfection, growing, in the unit of the label.
    deviation : callable
        Size in, rig out.
    loops : tuple of Loop
        What is compared.
    """

    name: str
    label: str
    values: tuple[float, ...]
    deviation: Callable[[float], Deviation]
    loops: tuple[Loop, ...] = COMPARED


def _height(height: float) -> Deviation:
    return Deviation(replace(CALIBRATED, height=0.01 * height))


def _mass(error: float) -> Deviation:
    return Deviation(replace(CALIBRATED, mass_error=0.01 * error))


def _grip(grip: float) -> Deviation:
    return Deviation(replace(CALIBRATED, physics=replace(PHYSICS, grip=grip)))


def _noise(factor: float) -> Deviation:
    louder = Faults(
        position_noise=factor * FAULTS.position_noise,
        velocity_noise=factor * FAULTS.velocity_noise,
        tilt_noise=factor * FAULTS.tilt_noise,
        delay=FAULTS.delay,
    )
    return Deviation(replace(CALIBRATED, faults=louder))


def _offset(offset: float) -> Deviation:
    return Deviation(replace(CALIBRATED, tilt_offset=0.0, faults=replace(FAULTS, tilt_offset=0.001 * offset)))


def _delay(delay: float) -> Deviation:
    return Deviation(replace(CALIBRATED, faults=replace(FAULTS, delay=0.001 * delay)))


def _torque(torque: float) -> Deviation:
    return Deviation(replace(CALIBRATED, physics=replace(PHYSICS, torque=0.001 * torque)))


def _stiffness(stiffness: float) -> Deviation:
    return Deviation(replace(CALIBRATED, physics=replace(PHYSICS, stiffness=0.001 * stiffness)))


def _friction(factor: float) -> Deviation:
    known = Plane().friction
    true = Friction(factor * known.g1, known.g2, known.g3, factor * known.g4, known.g5, factor * known.g6)
    return Deviation(CALIBRATED, (f"plane.friction={list(true)}",))


MAPS = {
    study.name: study
    for study in (
        Map("height", "height of the masses, cm", (2, 3, 4, 6, 8, 10), _height, (*COMPARED, COMPENSATED)),
        Map("mass", "largest mass error, %", (5, 10, 15, 20, 30), _mass, (*COMPARED, DAMPED, NARROW)),
        Map("grip", "grip of the wheels", (0.6, 0.2, 0.1, 0.05), _grip),
        Map("noise", "noise, times that by seed", (1, 3, 10, 30), _noise),
        Map("offset", "encoder offset, mrad", (2, 10, 20, 30), _offset),
        Map("delay", "delay of readings and commands, ms", (20, 40, 60, 80, 100), _delay),
        Map("torque", "torque limit of a wheel, mN m", (50, 10, 5, 3, 2), _torque),
        Map("stiffness", "stiffness of velocity loops, mN m s", (6, 2, 1, 0.5, 0.25), _stiffness),
        Map("friction", "bearing's friction, times known", (0.1, 0.3, 1, 3, 10), _friction),
    )
}
"""All maps by name."""
