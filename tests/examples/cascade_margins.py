"""The loops of docs/cascade.md, linearised, as frequency responses for python-control."""

from __future__ import annotations

from typing import TYPE_CHECKING

import control
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Complex = NDArray[np.complex128]

PERIOD, INERTIA, FILTER = 0.01, 0.525, 50.0
UPPER_GAINS, LOWER_GAINS, SWARM_GAIN = (2.0, 1.0), (30.0, 6.0), 1.5
FREQUENCIES = np.logspace(-2.5, 2.5, 20001)


def _plane(s: Complex, slope: float) -> Complex:
    return 1.0 / (INERTIA * s**2 + slope * s)


def _torque(s: Complex) -> Complex:
    """The command filter, and the command that is held for a period."""
    return (FILTER / (s + FILTER)) ** 2 * np.exp(-0.5 * PERIOD * s)


def _lower(s: Complex, slope: float) -> Complex:
    return (LOWER_GAINS[0] + LOWER_GAINS[1] * s) * _torque(s) * _plane(s, slope)


def _drive(s: Complex, slope: float, bandwidth: float) -> Complex:
    """From the command of an upper robot to its speed: G."""
    loop = _lower(s, slope)
    following = (loop + _torque(s)) / (1.0 + loop)
    return np.exp(-1.5 * PERIOD * s) * (bandwidth / (s + bandwidth)) ** 3 * following


def loops(upper_slope: float, lower_slope: float, bandwidth: float) -> dict[str, Complex]:
    """Return the frequency responses of the opened loops."""
    s = 1j * FREQUENCIES
    drive = _drive(s, lower_slope, bandwidth)
    swarm = (s + SWARM_GAIN) * drive / (s + SWARM_GAIN * drive)
    law = UPPER_GAINS[0] + UPPER_GAINS[1] * s
    return {
        "lower plane": _lower(s, lower_slope),
        "upper swarm": SWARM_GAIN * drive / s,
        "upper plane": law * _torque(s) * swarm * _plane(s, upper_slope),
    }


def margins(response: Complex) -> tuple[float, float, float]:
    """Return crossover (rad/s), phase margin (degrees) and gain margin."""
    gain, phase, _, _, crossover, _ = control.stability_margins(control.frd(response, FREQUENCIES))
    return float(crossover), float(phase), float(gain)
