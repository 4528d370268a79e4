"""A fingerprint of the machine's mathematical library: it explains why a digest differs elsewhere."""

from __future__ import annotations

import math
import struct
from hashlib import sha256

_PROBES = tuple(0.001 * n * 1.37**n for n in range(1, 40))
_FUNCTIONS = (math.tanh, math.cos, math.sin, math.exp, math.expm1)


def libm_fingerprint() -> str:
    """Return a short hash of the values of tanh, cos, sin, exp and expm1 at fixed arguments.

    These are all functions beyond correctly rounded arithmetic on which a recorded number depends: equal
    fingerprints mean that equal scenarios give equal digests.
    """
    values = [f(math.copysign(x, (-1) ** n)) for f in _FUNCTIONS for n, x in enumerate(_PROBES) if x < 700.0]
    return sha256(struct.pack(f"<{len(values)}d", *values)).hexdigest()[:16]
