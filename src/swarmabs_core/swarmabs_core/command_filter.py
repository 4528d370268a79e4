"""Critically damped second-order command filter, discretised exactly for an input held over a period."""

from __future__ import annotations

from math import exp

BANDWIDTH = 50.0
"""Corner frequency of the filter between parent controller and manifold, rad/s."""


class CommandFilter:
    """x'' = w^2 (u - x) - 2 w x', advanced by whole periods (s), with the bandwidth w in rad/s."""

    def __init__(self, period: float, bandwidth: float = BANDWIDTH) -> None:
        wt = bandwidth * period
        decay = exp(-wt)
        self._a11 = (1.0 + wt) * decay
        self._a12 = period * decay
        self._a21 = -bandwidth * wt * decay
        self._a22 = (1.0 - wt) * decay

    def advance(self, value: float, rate: float, command: float) -> tuple[float, float]:
        """Return value and rate one period later, with the command held."""
        offset = value - command  # the filter moves towards the command: integrate the distance to it
        return command + self._a11 * offset + self._a12 * rate, self._a21 * offset + self._a22 * rate
