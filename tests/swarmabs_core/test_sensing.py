from __future__ import annotations

from fractions import Fraction
from hashlib import blake2b

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from swarmabs_core.sensing import Sensor, standard_normal

COUNT = 20_000


def test_draw_is_the_documented_one() -> None:
    """Once more from the words of docs/design.md, with SciPy's quantile."""
    for text in ("1:0:plane:value", "7:803:17:rate"):
        bits = int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "big") >> 12
        assert standard_normal(text) == pytest.approx(stats.norm.ppf((bits + 0.5) / 2**52), rel=1e-12)


def test_draws_are_normal_and_independent() -> None:
    draws = np.array([standard_normal(f"1:{step}:plane:value") for step in range(COUNT)])
    assert stats.kstest(draws, "norm").pvalue > 0.01
    others = {
        "next step": np.roll(draws, 1),
        "rate": np.array([standard_normal(f"1:{step}:plane:rate") for step in range(COUNT)]),
        "another robot": np.array([standard_normal(f"1:{step}:3:value") for step in range(COUNT)]),
        "another seed": np.array([standard_normal(f"2:{step}:plane:value") for step in range(COUNT)]),
    }
    for what, other in others.items():
        assert abs(np.corrcoef(draws, other)[0, 1]) < 4.0 / COUNT**0.5, what


def test_noise_has_the_standard_deviations_that_are_asked_for() -> None:
    sensor = Sensor(noise=(0.01, 0.3))
    found = np.array([sensor.measure(1.0, -2.0, f"1:{step}:plane") for step in range(COUNT)])
    assert found.mean(axis=0) == pytest.approx([1.0, -2.0], abs=4 * 0.3 / COUNT**0.5)
    assert found.std(axis=0) == pytest.approx([0.01, 0.3], rel=4 / (2 * COUNT) ** 0.5)


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 10.0))
def test_resolution_rounds_to_the_nearest_multiple(value: float, step: float) -> None:
    found, rate = Sensor(resolution=(step, 0.0)).measure(value, value, "")
    multiple = Fraction(step) * round(Fraction(value) / Fraction(step))
    assert found == pytest.approx(float(multiple), rel=1e-15, abs=1e-15 * step)
    assert rate == value


def test_noise_comes_before_rounding() -> None:
    steps = [Sensor((0.3, 0.0), (0.1, 0.0)).measure(0.0, 0.0, f"1:{k}:plane")[0] / 0.1 for k in range(200)]
    assert steps == pytest.approx(np.round(steps), abs=1e-9)
    assert len(set(np.round(steps))) > 5


def test_perfect_sensor_tells_the_truth() -> None:
    assert Sensor().perfect
    assert Sensor().measure(0.1, -0.2, "") == (0.1, -0.2)
    assert not Sensor(noise=(0.0, 0.1)).perfect
    assert not Sensor(resolution=(0.1, 0.0)).perfect
