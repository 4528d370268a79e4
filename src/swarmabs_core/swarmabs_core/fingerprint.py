"""A fingerprint of the machine's mathematical library: it explains why a digest differs elsewhere."""

from __future__ import annotations

import math
import struct
from hashlib import sha256
from statistics import NormalDist

_PROBES = tuple(0.001 * n * 1.37**n for n in range(1, 40))


def _normal_quantile(x: float) -> float:
    """Return the quantile that noise is drawn by, at a probability between 0 and 1 that grows with x."""
    return NormalDist().inv_cdf(0.5 + 0.499999 * x / (1.0 + abs(x)))


_FUNCTIONS = (math.tanh, math.cos, math.sin, math.exp, math.expm1, _normal_quantile)


def libm_fingerprint() -> str:
    """Return a short hash of tanh, cos, sin, exp, expm1 and the normal quantile at fixed arguments.

    These are all functions beyond correctly rounded arithmetic on which a recorded number depends: equal
    fingerprints mean that equal scenarios give equal digests.
    """
    values = [f(math.copysign(x, (-1) ** n)) for f in _FUNCTIONS for n, x in enumerate(_PROBES) if x < 700.0]
    return sha256(struct.pack(f"<{len(values)}d", *values)).hexdigest()[:16]
