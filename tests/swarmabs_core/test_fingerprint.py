import math
import struct
from collections.abc import Callable
from hashlib import sha256
from statistics import NormalDist

from swarmabs_core.fingerprint import libm_fingerprint, libm_fingerprints


def quantile(x: float) -> float:
    return NormalDist().inv_cdf(0.5 + 0.499999 * x / (1.0 + abs(x)))


def hash_of(*functions: Callable[[float], float]) -> str:
    """Hash of the last bit of functions at 39 arguments of both signs, but for those that would overflow."""
    values = [
        function((-1) ** n * x)
        for function in functions
        for n in range(39)
        if (x := 0.001 * (n + 1) * 1.37 ** (n + 1)) < 700
    ]
    return sha256(struct.pack(f"<{len(values)}d", *values)).hexdigest()[:16]


def test_every_bit_of_every_function_counts_and_bags_of_earlier_versions_are_known() -> None:
    earlier = (math.tanh, math.cos, math.sin, math.exp, math.expm1)
    assert libm_fingerprint() == hash_of(*earlier, quantile)
    assert libm_fingerprints() == (libm_fingerprint(), hash_of(*earlier))
