"""Fleets on a virtual clock, by seed: nothing is broken, what is planted is found, and a seed repeats itself."""

import importlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.processes import marked_processes, until
from tests.virtual.planted import LATE, MINUTES, PLANTED, Planted, changed
from tests.virtual.schedule import Case, Fault
from tests.virtual.search import drawn, main, replay, run, shortened

from swarmabs_core.realtime.broadcasts import BroadcastInbox


@pytest.fixture
def old_broadcasts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let robots act on broadcasts up to three times as old as they may."""
    problem = BroadcastInbox.problem

    def lenient(self: BroadcastInbox, now: int) -> str:
        self._age *= 3
        try:
            return problem(self, now)
        finally:
            self._age //= 3

    monkeypatch.setattr(BroadcastInbox, "problem", lenient)


@pytest.mark.parametrize("first", range(1, 17, 4))
def test_nothing_is_broken(first: int) -> None:
    broken = {seed: str(found) for seed in range(first, first + 4) if (found := run(drawn(seed)).broken)}
    assert broken == {}


@pytest.mark.full
@pytest.mark.timeout(0)
def test_nothing_is_broken_with_new_seeds() -> None:
    assert main(["--minutes", "30"]) == 0


@pytest.mark.parametrize("planted", PLANTED, ids=lambda planted: planted.name)
def test_what_is_planted_is_a_mistake_in_one_place(planted: Planted) -> None:
    source = Path(importlib.import_module(planted.module).__file__ or "").read_text(encoding="utf-8")
    compile(changed(source, planted), planted.module, "exec")


@pytest.mark.full
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", LATE)
def test_what_is_planted_is_found(name: str) -> None:
    words = [sys.executable, "-m", "tests.virtual.planted", name, "--minutes", str(MINUTES)]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_its_processes_end_with_it(nothing_survives: str, tmp_path: Path, number: signal.Signals) -> None:
    """One that is killed cannot tidy up: the kernel ends what was started, and temporary files stay."""
    words = [sys.executable, "-m", "tests.virtual.search", "--minutes", "5", "--jobs", "2"]
    own = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=own) as process:
        until(lambda: len(marked_processes(nothing_survives)) == 3, "it searches in two processes", 60.0)
        process.send_signal(number)
        _, errors = process.communicate()
        until(lambda: not marked_processes(nothing_survives), "all are gone")
    if number != signal.SIGKILL:
        assert (process.returncode, errors.startswith("interrupted: ")) == (1, True)
        assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("old_broadcasts")
def test_what_is_wrong_is_shown_with_what_led_to_it(capsys: pytest.CaptureFixture[str]) -> None:
    seed = next(seed for seed in range(1, 30) if (broken := run(drawn(seed)).broken) and "fresh" in broken.name)
    assert main(["--seeds", str(seed)]) == 1
    told = capsys.readouterr().out
    assert "BROKEN: acts on one fresh set" in told
    assert f"replay:    ./scripts/swarm soak --virtual --seeds {seed}" in told
    assert "steps is the age limit" in told.splitlines()[-2]
    assert main(["--seeds", f"{seed}-{seed}", "--jobs", "2"]) == 1
    *case, total = capsys.readouterr().out.splitlines()
    assert case[0] == told.splitlines()[0]
    assert f"replay:    ./scripts/swarm soak --virtual --seeds {seed}" in case[3]
    assert case[-2].endswith("steps is the age limit")
    assert total.startswith("1 seeds in") and total.endswith("broken: acts on one fresh set 1")


@pytest.mark.usefixtures("old_broadcasts")
def test_a_case_is_shortened_to_the_faults_that_matter() -> None:
    harmless = [Fault(2.7 + 0.1 * number, "loss", "*>*", 0.05, 0.02) for number in range(6)]
    faults = tuple(sorted([*harmless, Fault(3.0, "crash", "parent_controller", 2.0)]))
    case = Case(1, robots=3, faults=faults, quiet=5.0)
    result, timeline, _ = replay(case)
    assert result.broken is not None
    assert "parent_controller: dies" in "\n".join(timeline.lines())
    assert [case.faults[number].kind for number in shortened(case, result.broken.name)] == ["crash"]


@pytest.mark.parametrize("seed", [8, 9])
def test_a_seed_gives_the_same_bytes_in_every_process(seed: int, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    replay(drawn(seed), here)
    words = [sys.executable, "-m", "tests.virtual.search", "--seeds", str(seed), "--trace", str(there)]
    subprocess.run(words, check=False, env={**os.environ, "PYTHONHASHSEED": "1"}, capture_output=True)
    assert here.read_bytes() == there.read_bytes()
    assert here.stat().st_size > 10**4
