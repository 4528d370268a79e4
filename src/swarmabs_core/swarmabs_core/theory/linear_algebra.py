"""Numerics of the theory, by numpy alone, which every platform has."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, log2, pi, sqrt
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Matrix: TypeAlias = NDArray[np.float64]

_DEGREE = 13
"""Degree of the Padé approximant of the exponential."""
_LARGEST_NORM = 5.371920351148152
"""Largest 1-norm at which it is exact to rounding (N. J. Higham, SIAM J. Matrix Anal. Appl. 26, 2005, table 2.3)."""
_NODES = 32
"""Nodes of the trapezoidal rule on a circle."""
_SECTIONS = 60
"""Golden sections: an interval shrinks by a factor of 3e12."""


def exponential(matrix: Matrix) -> Matrix:
    """Return the exponential of a matrix (n, n), by a Padé approximant with scaling and squaring."""
    norm = float(np.linalg.norm(matrix, 1))
    squarings = max(0, ceil(log2(norm / _LARGEST_NORM))) if norm else 0
    scaled = matrix / 2.0**squarings
    term = even = np.eye(len(matrix))
    odd = np.zeros_like(matrix)
    for n in range(1, _DEGREE + 1):
        term = term @ scaled * ((_DEGREE - n + 1) / (n * (2 * _DEGREE - n + 1)))
        even, odd = (even, odd + term) if n % 2 else (even + term, odd)
    result: Matrix = np.linalg.solve(even - odd, even + odd)
    for _ in range(squarings):
        result = result @ result
    return result


def discrete_lyapunov(matrix: Matrix, right: Matrix) -> Matrix:
    """Return X with X = A X A^T + Q, all (n, n)."""
    size = len(matrix)
    solution = np.linalg.solve(np.eye(size * size) - np.kron(matrix, matrix), right.ravel())
    return solution.reshape(size, size)


def subspace_outside(matrix: Matrix, centre: float, radius: float) -> Matrix:
    """Return an orthonormal basis (n, m) of the invariant subspace of all eigenvalues outside a circle.

    The projector on it is I minus the mean over the circle of (z - centre) (z I - A)^-1. Its singular values are 0 or
    at least 1, whether or not the matrix can be diagonalised.
    """
    unit = np.eye(len(matrix))
    points = radius * np.exp(2j * pi * (np.arange(_NODES) + 0.5) / _NODES)
    inside = [(z * np.linalg.inv((centre + z) * unit - matrix)).real for z in points]
    basis, values, _ = np.linalg.svd(unit - np.mean(inside, axis=0))
    return np.asarray(basis[:, values > 0.5])


def minimum(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the smallest value of a function between two arguments, by golden sections; it has one minimum there."""
    ratio = (sqrt(5.0) - 1.0) / 2.0
    left, right = high - ratio * (high - low), low + ratio * (high - low)
    at_left, at_right = function(left), function(right)
    for _ in range(_SECTIONS):
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = high - ratio * (high - low)
            at_left = function(left)
        else:
            low, left, at_left = left, right, at_right
            right = low + ratio * (high - low)
            at_right = function(right)
    return min(at_left, at_right)
