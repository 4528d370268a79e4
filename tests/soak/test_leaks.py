"""Growth is told from differences that mean nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.soak.leaks import FEWEST, Sample, growth, sample
from tests.soak.test_invariants import FAULTS
from tests.soak.trial import lockstep_violations
from tests.swarmabs_core.helpers import builtin

CALM = Sample(60.0, 50_000, 6, 1, 0)


@pytest.mark.parametrize(
    ("field", "each"), [("memory", 3.0), ("objects", 300), ("descriptors", 1), ("threads", 1), ("children", 1)]
)
def test_what_grows_is_named(field: str, each: float) -> None:
    samples = [CALM._replace(**{field: getattr(CALM, field) + each * run}) for run in range(30)]
    assert [one.what for one in growth(samples) if not one.ok] == [field]


def test_caches_that_fill_at_first_and_runs_of_different_size_are_no_growth() -> None:
    warm = [CALM._replace(memory=20.0 * run, objects=10_000 * run, descriptors=run) for run in range(5)]
    steady = [CALM._replace(memory=60.0 + 10.0 * (run % 2), objects=50_000 + 500 * (run % 3)) for run in range(20)]
    assert all(one.ok for one in growth([*warm, *steady]))


def test_few_runs_are_not_judged() -> None:
    samples = [CALM._replace(descriptors=run) for run in range(FEWEST - 1)]
    assert all(one.allowed is None and one.ok for one in growth(samples))
    assert not all(one.ok for one in growth([*samples, CALM._replace(descriptors=FEWEST)]))


def test_an_open_file_is_seen() -> None:
    before = sample()
    with Path(__file__).open(encoding="utf-8"):
        assert sample().descriptors == before.descriptors + 1


@pytest.mark.full
@pytest.mark.timeout(600)
def test_runs_one_after_the_other_hold_no_more_and_more() -> None:
    scenario = builtin("pd_het_4", "duration=6", FAULTS)
    samples = []
    for _ in range(20):
        assert lockstep_violations(scenario) == []
        samples.append(sample())
    assert [one for one in growth(samples) if not one.ok] == []
