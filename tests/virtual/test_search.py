"""Fleets on a virtual clock, by seed: nothing is broken, what is planted is found, and a seed repeats itself."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.virtual.planted import PLANTED, old_broadcasts
from tests.virtual.schedule import Case, Fault, case_of
from tests.virtual.search import drawn, main, replay, run, shortened

from swarmabs_core.errors import InputError

FOUND_WITHIN = 600
"""Seeds within which each planted fault is found: ten minutes of a processor."""


@pytest.mark.parametrize("first", range(1, 17, 4))
def test_nothing_is_broken(first: int) -> None:
    broken = {seed: str(found) for seed in range(first, first + 4) if (found := run(drawn(seed)).broken)}
    assert broken == {}


@pytest.mark.full
@pytest.mark.timeout(0)
def test_nothing_is_broken_with_new_seeds() -> None:
    assert main(["--minutes", "30"]) == 0


@pytest.mark.full
@pytest.mark.timeout(0)
@pytest.mark.parametrize("plant", PLANTED, ids=lambda plant: plant.__name__)
def test_what_is_planted_is_found(plant: object, monkeypatch: pytest.MonkeyPatch) -> None:
    assert callable(plant)
    plant(monkeypatch)
    assert any(run(drawn(seed)).broken for seed in range(1, FOUND_WITHIN))


def test_what_is_wrong_is_shown_with_what_led_to_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    old_broadcasts(monkeypatch)
    seed = next(seed for seed in range(1, 30) if (broken := run(drawn(seed)).broken) and "fresh" in broken.name)
    assert main(["--seeds", str(seed)]) == 1
    told = capsys.readouterr().out
    assert "BROKEN: acts on one fresh set" in told
    assert f"replay:    ./scripts/swarm soak --virtual --seeds {seed}" in told
    assert "steps is the age limit" in told.splitlines()[-2]


def test_a_case_is_shortened_to_the_faults_that_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    old_broadcasts(monkeypatch)
    harmless = [Fault(2.7 + 0.1 * number, "loss", "*>*", 0.05, 0.02) for number in range(6)]
    faults = tuple(sorted([*harmless, Fault(3.0, "crash", "parent_controller", 2.0)]))
    case = Case(1, robots=3, faults=faults, quiet=5.0)
    result, timeline, _ = replay(case)
    assert result.broken is not None
    assert "parent_controller: dies" in "\n".join(timeline.lines())
    assert [case.faults[number].kind for number in shortened(case, result.broken.name)] == ["crash"]


def test_a_case_is_text_that_can_be_read_again() -> None:
    for seed in range(50):
        case = case_of(seed)
        assert [Fault.parse(str(fault)) for fault in case.faults] == list(case.faults)
    for line in ("2.0", "2.0 melt agent_001", "now crash agent_001"):
        with pytest.raises(InputError, match="fault"):
            Fault.parse(line)


@pytest.mark.parametrize("seed", [8, 9])
def test_a_seed_gives_the_same_bytes_in_every_process(seed: int, tmp_path: Path) -> None:
    traces = []
    for number in (1, 2):
        trace = tmp_path / str(number)
        words = [sys.executable, "-m", "tests.virtual.search", "--seeds", str(seed), "--trace", str(trace)]
        subprocess.run(words, check=False, env={**os.environ, "PYTHONHASHSEED": str(number)}, capture_output=True)
        traces.append(trace.read_bytes())
    assert traces[0] == traces[1]
    assert len(traces[0]) > 10**4
