"""The command ``replay``, as far as it needs no other process."""

import json
import re
import shutil
from pathlib import Path

import pytest
from tests.swarmabs_cli.conftest import document, ran, refused

from swarmabs_bag.reader import open_bag


@pytest.fixture
def bag(run: Path, here: Path) -> str:
    shutil.copytree(run, here / "a")
    return "a"


def test_a_replay_leaves_what_a_run_leaves(bag: str, here: Path) -> None:
    found = document("replay", bag, "--node", "plane", "--in-process", "--expect-same")
    folder = here / "runs" / "pd_het_4-replay-001"
    assert json.loads((folder / "summary.json").read_text()) == found
    recorded = document("verify", bag)
    assert (found["steps"], found["status"]) == (30, "ok")
    assert found["digest"] == recorded["digest"] == found["replay"]["of"]
    assert found["messages"] == recorded["messages"]
    provenance = json.loads(open_bag(folder).attachment("provenance.json") or b"")
    assert provenance["replay"] == {"of": recorded["digest"], "nodes": ["parent"], "overrides": []}
    assert (folder / "scenario.yaml").read_text() == (here / bag / "scenario.yaml").read_text()


def test_another_digest_is_a_failure_only_if_the_same_is_expected(bag: str) -> None:
    words = ("replay", bag, "--node", "controller", "--in-process", "--set", "controller.gains=[20, 3]")
    found = document(*words, "-o", "c", "--expect-same", code=1)
    assert (found["status"], found["replay"]["same"]) == ("ok", False)
    assert found["replay"]["overrides"] == ["controller.gains=[20, 3]"]
    text = ran(*words, "-o", "d").out
    assert "step 0, swarm/desired_abstract_state, torque is 2.0, was 0.3162" in text
    assert "open loop" in text
    assert re.search(r"^swarm/desired_abstract_state\s*$", text, re.MULTILINE)
    assert re.search(r"^  mean_inertia_rate +\d+ +[\d.e-]+ +\d+ +-$", text, re.MULTILINE)
    assert "…" not in text


def test_a_part_may_be_the_same_although_the_digest_of_the_whole_is_another(bag: str) -> None:
    found = document("replay", bag, "--node", "agent:2", "--in-process", "--duration", "0.2", "--expect-same")
    assert (found["steps"], found["replay"]["same"], found["replay"]["compared"]) == (20, True, 21)
    assert found["digest"] != found["replay"]["of"]


def test_a_node_that_fails_is_exit_code_1(bag: str) -> None:
    disturbed = "plane.disturbance={amplitude: 5000, angular_frequency: 1}"
    words = ("--node", "plane", "--node", "controller", "--in-process", "--set", disturbed)
    found = document("replay", bag, *words, code=1)
    assert (found["status"], found["replay"]) == ("failed", None)
    assert "a run ends at 1.5 rad" in found["reason"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--node", "robot:1"], "no node 'robot:1'; use controller, observer, parent, or agent:N"),
        (["--node", "agent:9"], "--node agent:9: the bag has no states of robot 9"),
        (["--node", "plane", "--set", "step=0.005"], "--set changes the control period"),
        (["--node", "plane", "--rate", "2"], "--rate cannot be combined with --node"),
        (["--node", "plane", "--loop"], "--loop cannot be combined with --node"),
        (["--in-process"], "--in-process needs --node"),
        (["--set", "plane.angle=0.2"], "--set needs --node"),
        (["--topics", "/nothing"], "--topics: "),
        (["--rate", "0"], "--rate"),
    ],
)
def test_what_makes_no_sense_is_refused_and_leaves_nothing(bag: str, words: list[str], message: str) -> None:
    assert message in refused("replay", bag, *words)
