"""The arithmetic of recorded numbers by number, which bags name (docs/explanation/arithmetic.md).

It has another number whenever a digest changes although scenario and seed do not.
"""

from __future__ import annotations

ARITHMETIC = 2
"""Functions that are correctly rounded, exact sums, and the integrator of `swarmabs_core.runge_kutta`."""
FORMER = 1
"""The functions of the machine's mathematical library."""
FORMER_TOLERANCE = 1e-9
"""What a number of the former arithmetic may differ by from today's, as the tolerance of `verify`."""
FORMER_INTEGRATOR = 1e-6
"""The same for angle and angular velocity of the plane, by which equal steps of 1 ms erred in a period."""
VERIFIED_FORMER = "versions of 0.1.0 that record no arithmetic, as at commit 198b2d0,"
"""The versions that compute with the former arithmetic."""
