from __future__ import annotations

import math
import re

import pytest

from swarmabs_core import fingerprint


def test_is_short_and_always_the_same() -> None:
    first = fingerprint.libm_fingerprint()
    assert re.fullmatch(r"[0-9a-f]{16}", first)
    assert fingerprint.libm_fingerprint() == first


def test_earlier_versions_of_it_are_known() -> None:
    now, *earlier = fingerprint.libm_fingerprints()
    assert now == fingerprint.libm_fingerprint()
    assert len({now, *earlier}) == 1 + len(earlier) == 2


def test_one_last_bit_in_one_function_changes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    first = fingerprint.libm_fingerprint()

    def other_tanh(x: float) -> float:
        return math.nextafter(math.tanh(x), 2.0)

    functions = tuple(other_tanh if f is math.tanh else f for f in fingerprint._FUNCTIONS)
    assert functions != fingerprint._FUNCTIONS
    monkeypatch.setattr(fingerprint, "_FUNCTIONS", functions)
    assert fingerprint.libm_fingerprint() != first
