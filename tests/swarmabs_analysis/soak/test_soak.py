"""Whole soaks: what is reported, what is kept, and that what goes wrong is found and can be repeated."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from swarmabs_analysis.soak import draw, engine as engines, run as soaks
from swarmabs_analysis.soak.engine import LockstepEngine
from swarmabs_analysis.soak.run import Extent, Soak, run_soak
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.recording import RecordedStep
from swarmabs_cli import main
from swarmabs_config.scenario import Scenario
from swarmabs_core.cdr import encode
from swarmabs_core.errors import RunError
from swarmabs_core.messages import AgentState

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make runs short; their faults come early."""
    monkeypatch.setattr(draw, "DURATION", 14.0)
    monkeypatch.setattr(draw, "FAULTS_UNTIL", 7.0)


def soaked(folder: Path, engine: engines.Engine, runs: int = 1) -> Soak:
    folder.mkdir()
    return run_soak(Extent(5, 0, runs, 4), engine, folder, lambda soak: None)


def broken(soak: Soak) -> list[tuple[str, int | None, int | None]]:
    return [violation[:3] for trial in soak.trials for violation in trial.violations]


def test_a_soak_and_one_of_its_runs_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["soak", "--seed", "5", "--robots", "4", "--json", "-o"]
    assert main([*words, str(tmp_path / "all"), "--runs", "2"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((tmp_path / "all" / "soak.json").read_text(encoding="utf-8"))
    assert (document["status"], document["finished"], document["failures"]) == ("ok", 2, [])
    assert sorted(path.name for path in (tmp_path / "all").iterdir()) == ["soak.json", "soak.md"]
    assert main([*words, str(tmp_path / "one"), "--only", "1"]) == 0
    (again,) = json.loads(capsys.readouterr().out)["trials"]
    assert again == document["trials"][1]
    assert again["digest"] != document["trials"][0]["digest"]


class Nudging(LockstepEngine):
    """The messages of a run, with a position that is off in its last bits."""

    def steps(self, scenario: Scenario) -> Iterator[RecordedStep]:
        for step in super().steps(scenario):
            if step.step == 40:
                records = list(step.records)
                state = records[0].message
                assert isinstance(state, AgentState)
                changed = state._replace(position=state.position + 1e-15)
                records[0] = records[0]._replace(message=changed, payload=encode(changed))
                yield step._replace(records=tuple(records))
            else:
                yield step


def test_a_message_that_does_not_follow_is_found_and_kept(tmp_path: Path) -> None:
    soak = soaked(tmp_path / "soak", Nudging())
    assert soak.status == "failed"
    assert [place[:2] for place in broken(soak)] == [("verification", 40)]
    kept = BagToVerify(tmp_path / "soak" / "run-00000").verify()
    assert kept.difference is not None
    assert (kept.difference.step, kept.difference.field) == (40, "position")


class Forgetful(LockstepEngine):
    """A second run is another."""

    def __init__(self) -> None:
        self._runs = 0

    def steps(self, scenario: Scenario) -> Iterator[RecordedStep]:
        self._runs += 1
        steps = super().steps(scenario)
        return steps if self._runs == 1 else (step for step in steps if step.step != 7)


def test_a_run_that_cannot_be_repeated_is_found(tmp_path: Path) -> None:
    assert broken(soaked(tmp_path / "soak", Forgetful())) == [("repetition", None, None)]


class Failing(LockstepEngine):
    """A run that ends before its end."""

    def steps(self, scenario: Scenario) -> Iterator[RecordedStep]:
        for step in super().steps(scenario):
            if step.step == 100 and scenario.name.endswith("_1"):
                raise RunError("the plane turns over")
            yield step


def test_a_run_that_fails_and_the_next_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(engines, "LockstepEngine", Failing)
    folder = tmp_path / "soak"
    assert main(["soak", "--runs", "3", "--robots", "4", "--seed", "5", "-o", str(folder)]) == 1
    out, err = capsys.readouterr()
    command = "swarm soak --seed 5 --robots 4 --only 1"
    assert command in out
    assert f"1 of 3 runs failed, first 1: run: the plane turns over; again by {command}" in err
    document = json.loads((folder / "soak.json").read_text(encoding="utf-8"))
    assert document["failures"] == [{"number": 1, "command": command, "folder": "run-00001"}]
    assert sorted(path.name for path in folder.iterdir()) == ["run-00001", "soak.json", "soak.md"]
    assert (folder / "run-00001" / "scenario.yaml").is_file()
    assert BagToVerify(folder / "run-00001").verify().ended_early == "the plane turns over"


def test_a_leak_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample, taken = soaks.sample, iter(range(100))
    monkeypatch.setattr(soaks, "sample", lambda: sample()._replace(descriptors=6 + next(taken)))
    monkeypatch.setattr(soaks, "run_trial", lambda number, *others: soaks.Trial(number, 4, 1, 0.01, []))
    soak = soaked(tmp_path / "soak", LockstepEngine(), runs=12)
    assert (soak.status, [one.what for one in soak.growth if not one.ok]) == ("failed", ["descriptors"])


def test_an_end_that_is_asked_for(tmp_path: Path) -> None:
    class Asking(LockstepEngine):
        def steps(self, scenario: Scenario) -> Iterator[RecordedStep]:
            for step in super().steps(scenario):
                if step.step == 50 and scenario.name.endswith("_1"):
                    signal.raise_signal(signal.SIGINT)
                yield step

    soak = soaked(tmp_path / "soak", Asking(), runs=3)
    assert (soak.status, len(soak.trials)) == ("interrupted", 1)
    assert list((tmp_path / "soak").iterdir()) == []


@pytest.mark.parametrize(
    "words", [["--runs", "0"], ["--hours", "0"], ["--robots", "3"], ["--runs", "1", "--only", "2"], ["--seed", "-1"]]
)
def test_what_is_refused(words: list[str], tmp_path: Path) -> None:
    assert main(["soak", *words, "-o", str(tmp_path / "soak")]) == 2
    assert not (tmp_path / "soak").exists()


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_an_hour_of_simulated_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    assert main(["soak", "--hours", "1", "--seed", "20", "-o", str(tmp_path / "soak")]) == 0
