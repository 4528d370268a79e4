"""A fingerprint of the machine's mathematical library, which explains why digests differ between machines."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from hashlib import sha256
from statistics import NormalDist

_PROBES = tuple(0.001 * n * 1.37**n for n in range(1, 40))


def _normal_quantile(x: float) -> float:
    """Return the quantile from which noise is drawn, at a probability between 0 and 1 that increases with x."""
    return NormalDist().inv_cdf(0.5 + 0.499999 * x / (1.0 + abs(x)))


_FUNCTIONS = (math.tanh, math.cos, math.sin, math.exp, math.expm1, _normal_quantile)
_EARLIER = (_FUNCTIONS[:5],)
"""Functions in the fingerprints of earlier versions, which drew no noise; only bags still contain them."""


def libm_fingerprint() -> str:
    """Return a short hash of tanh, cos, sin, exp, expm1 and the normal quantile at fixed arguments.

    Apart from correctly rounded arithmetic, recorded numbers depend on these functions only: with equal fingerprints,
    equal scenarios give equal digests.
    """
    return _hash(_FUNCTIONS)


def libm_fingerprints() -> tuple[str, ...]:
    """Return this machine's fingerprint, then its fingerprints in earlier versions."""
    return tuple(_hash(functions) for functions in (_FUNCTIONS, *_EARLIER))


def _hash(functions: Sequence[Callable[[float], float]]) -> str:
    values = [f(math.copysign(x, (-1) ** n)) for f in functions for n, x in enumerate(_PROBES) if x < 700.0]
    return sha256(struct.pack(f"<{len(values)}d", *values)).hexdigest()[:16]
