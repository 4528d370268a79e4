"""Injected communication faults, drawn so that every run and every process draws the same."""

from __future__ import annotations

from hashlib import blake2b


def lost(probability: float, seed: int, step: int, agent_id: int) -> bool:
    """Tell whether a robot misses the broadcasts of a step.

    The draw is the BLAKE2b hash of ``seed:step:agent`` in decimal, its first 53 of 64 bits read as a
    fraction.
    """
    if probability <= 0.0:
        return False
    digest = blake2b(f"{seed}:{step}:{agent_id}".encode(), digest_size=8).digest()
    return (int.from_bytes(digest, "big") >> 11) * 2.0**-53 < probability
