"""The command ``replay``, as far as it needs no other process."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from swarmabs_bag.reader import open_bag
from swarmabs_cli import main


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def bag(capfd: pytest.CaptureFixture[str]) -> str:
    assert main(["simulate", "--duration", "0.3", "-o", "a"]) == 0
    capfd.readouterr()
    return "a"


def document(capfd: pytest.CaptureFixture[str], *words: str, code: int = 0) -> Any:
    assert main(["replay", *words, "--json"]) == code
    return json.loads(capfd.readouterr().out, parse_constant=pytest.fail)


def test_a_replay_leaves_what_a_run_leaves(capfd: pytest.CaptureFixture[str], bag: str, here: Path) -> None:
    found = document(capfd, bag, "--node", "plane", "--in-process", "--expect-same")
    folder = here / "runs" / "pd_het_4-replay-001"
    assert json.loads((folder / "summary.json").read_text()) == found
    recorded = json.loads((here / bag / "summary.json").read_text())
    assert found["digest"] == recorded["digest"] == found["replay"]["of"]
    assert {name: found[name] for name in ("steps", "messages", "final_error", "status")} == {
        name: recorded[name] for name in ("steps", "messages", "final_error", "status")
    }
    provenance = json.loads(open_bag(folder).attachment("provenance.json") or b"")
    assert provenance["replay"] == {"of": recorded["digest"], "nodes": ["plane"], "overrides": []}
    assert (folder / "scenario.yaml").read_text() == (here / bag / "scenario.yaml").read_text()


def test_another_digest_is_a_failure_only_if_the_same_is_expected(capfd: pytest.CaptureFixture[str], bag: str) -> None:
    words = (bag, "--node", "controller", "--in-process", "--set", "controller.gains=[20, 3]")
    found = document(capfd, *words, "-o", "b")
    assert not found["replay"]["same"]
    assert found["replay"]["overrides"] == ["controller.gains=[20, 3]"]
    assert document(capfd, *words, "-o", "c", "--expect-same", code=1)["status"] == "ok"
    assert main(["replay", *words, "-o", "d"]) == 0
    text = capfd.readouterr().out
    assert "step 0, swarm/desired_abstract_state, torque is 2.0, was 0.3162" in text
    assert "open loop" in text
    assert re.search(r"^swarm/desired_abstract_state\s*$", text, re.MULTILINE)
    assert re.search(r"^  mean_inertia_rate +\d+ +[\d.e-]+ +\d+ +-$", text, re.MULTILINE)
    assert "…" not in text


def test_a_part_may_be_the_same_although_the_digest_of_the_whole_is_another(
    capfd: pytest.CaptureFixture[str], bag: str
) -> None:
    found = document(capfd, bag, "--node", "agent:2", "--in-process", "--duration", "0.2", "--expect-same")
    assert found["steps"] == 20
    assert found["replay"]["same"]
    assert found["replay"]["compared"] == 21
    assert found["digest"] != found["replay"]["of"]


def test_a_node_that_fails_is_exit_code_1(capfd: pytest.CaptureFixture[str], bag: str) -> None:
    disturbed = "plane.disturbance={amplitude: 5000, angular_frequency: 1}"
    words = ("--node", "plane", "--node", "controller", "--in-process", "--set", disturbed)
    found = document(capfd, bag, *words, code=1)
    assert (found["status"], found["replay"]) == ("failed", None)
    assert "a run ends at 1.5 rad" in found["reason"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--node", "robot:1"], "no node 'robot:1'; name controller, observer, plane, or a robot as agent:N"),
        (["--node", "agent:9"], "--node agent:9: the bag has no states of robot 9"),
        (["--node", "plane", "--set", "step=0.005"], "--set changes the control period"),
        (["--node", "plane", "--rate", "2"], "--rate is for a replay without --node; leave one of them out"),
        (["--node", "plane", "--loop"], "--loop is for a replay without --node"),
        (["--in-process"], "--in-process is for a replay with --node"),
        (["--set", "plane.angle=0.2"], "--set is for a replay with --node"),
        (["--topics", "/nothing"], "--topics: "),
        (["--rate", "0"], "--rate"),
    ],
)
def test_what_makes_no_sense_is_refused_and_leaves_nothing(
    capfd: pytest.CaptureFixture[str], bag: str, here: Path, words: list[str], message: str
) -> None:
    assert main(["replay", bag, *words]) == 2
    error = capfd.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert [path.name for path in here.iterdir()] == [bag]


def test_what_is_no_bag_is_refused(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    for words in ([], ["--node", "plane"]):
        assert main(["replay", str(here), *words]) == 2
        assert "holds no bag" in capfd.readouterr().err
