"""The commands ``replay`` and ``verify --node``, as far as they need no other process."""

import re
import shutil
from pathlib import Path

import pytest
from tests.swarmabs_cli.conftest import document, ran, refused

FRICTION = "plane.friction=[1e12, 1e12, 1e12, 1e12, 1e12, 1e12]"


@pytest.fixture
def bag(run: Path, here: Path) -> str:
    shutil.copytree(run, here / "a")
    return "a"


def test_a_node_that_answers_as_recorded_is_ok(bag: str) -> None:
    found = document("verify", bag, "--node", "plane", "--node", "agent:2")
    assert (found["ok"], found["complete"], found["nodes"]) == (True, True, ["parent", "agent:2"])
    assert (found["messages"], found["overrides"], found["deviations"]) == (62, [], [])
    assert found["digest"] == document("verify", bag)["digest"]
    text = ran("verify", bag, "--node", "plane", "--node", "agent:2").out
    assert "62 messages of 31 of 31 steps of parent, agent:2 agree bit for bit" in text


def test_other_settings_are_a_difference_with_the_deviation_of_each_field(bag: str) -> None:
    words = ("verify", bag, "--node", "controller", "--set", "controller.gains=[20, 3]")
    found = document(*words, code=1)
    assert (found["ok"], found["complete"], found["overrides"]) == (False, False, ["controller.gains=[20, 3]"])
    assert (found["first_difference"]["step"], found["first_difference"]["recomputed"]) == (0, 2.0)
    text = ran(*words, code=1).out
    assert "/swarm/desired_abstract_state, step 0: torque is 0.3162" in text and "recomputed 2.0" in text
    assert re.search(r"^swarm/desired_abstract_state\s*$", text, re.MULTILINE)
    assert re.search(r"^  mean_inertia_rate +\d+ +[\d.e-]+ +\d+ +-$", text, re.MULTILINE)
    assert "…" not in text


def test_a_node_that_fails_is_exit_code_1(bag: str) -> None:
    found = document("verify", bag, "--node", "plane", "--set", FRICTION, code=1)
    assert "not finite" in found["first_difference"]["reason"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["verify", "--node", "robot:1"], "no node 'robot:1'; use controller, observer, parent, or agent:N"),
        (["verify", "--node", "agent:9"], "--node agent:9: the scenario has no robot 9"),
        (["verify", "--node", "plane", "--set", "step=0.005"], "--set changes the control period"),
        (["verify", "--node", "plane", "--tolerance", "0.1"], "--tolerance cannot be combined with --node"),
        (["verify", "--set", "plane.angle=0.2"], "--set needs --node"),
        (["replay", "--node", "agent:9"], "--node agent:9: the scenario has no robot 9"),
        (["replay", "--node", "plane", "--loop"], "--loop cannot be combined with --node"),
        (["replay", "--node", "plane", "--start", "1"], "--start cannot be combined with --node"),
        (["replay", "--expect-same"], "--expect-same needs --node"),
        (["replay", "--topics", "/nothing"], "--topics: "),
        (["replay", "--rate", "0"], "--rate"),
    ],
)
def test_what_makes_no_sense_is_refused_and_leaves_nothing(bag: str, words: list[str], message: str) -> None:
    assert message in refused(words[0], bag, *words[1:])
