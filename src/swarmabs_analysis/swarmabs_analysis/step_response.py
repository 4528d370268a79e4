"""Rise time, overshoot, settling time and steady-state error of the response to a step of the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

RISE = (0.1, 0.9)
"""Shares of the change between which the rise time counts."""
BAND = 0.02
"""Share of the change within which the response has settled."""


@dataclass(frozen=True, slots=True)
class StepResponse:
    """How a quantity responds to a step, as defined in textbooks and by ``control.step_info``.

    The change is that from the value at the step to the final one, the last that was recorded.

    Attributes
    ----------
    at : float
        Time of the step, s.
    rise_time : float
        Time from 10 % to 90 % of the change, s.
    overshoot : float
        Largest excess over the final value, % of the change.
    settling_time : float
        Time from the step until the quantity stays within 2 % of the change around the final value, s.
    steady_state_error : float
        Reference minus final value, in the unit of the quantity.
    """

    at: float
    rise_time: float
    overshoot: float
    settling_time: float
    steady_state_error: float


def step_response(time: Floats, value: Floats, reference: Floats) -> StepResponse | None:
    """Return the response to the last step of a reference.

    Parameters
    ----------
    time : ndarray, (n,)
        Times of the samples, s.
    value, reference : ndarray, (n,)
        The quantity and its reference, in the same unit. A constant reference is a step at the first sample.

    Returns
    -------
    StepResponse or None
        None if the reference changes in two successive samples (it is no step), if samples are missing or not finite,
        or if the quantity does not change.
    """
    changed = np.flatnonzero(np.diff(reference)) + 1
    if not len(time) or np.any(np.diff(changed) == 1) or not np.all(np.isfinite([value, reference])):
        return None
    first = int(changed[-1]) if len(changed) else 0
    change = value[-1] - value[first]
    if change == 0.0:
        return None
    share = (value[first:] - value[first]) / change
    since = time[first:] - time[first]
    low, high = (int(np.argmax(share >= bound)) for bound in RISE)
    outside = np.flatnonzero(np.abs(share - 1.0) >= BAND)
    settled = int(outside[-1]) + 1  # the last sample is the final value, so one inside follows
    return StepResponse(
        at=float(time[first]),
        rise_time=float(since[high] - since[low]),
        overshoot=float(100.0 * (np.max(share) - 1.0)),
        settling_time=float(since[settled]),
        steady_state_error=float(reference[-1] - value[-1]),
    )
