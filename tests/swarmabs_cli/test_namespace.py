"""A bag of two swarms, made by the mcap library: every command that reads a swarm reads the one that is named."""

import csv
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.swarmabs_cli.conftest import document, last_command, ran, refused, rewritten

STEP, AGENT = 7, 3
CHANGED = ["swarm/agent_state", STEP, AGENT, "command"]
SWARMS = ("/east", "/west")


@pytest.fixture(scope="module")
def bag(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag of a run as two swarms; in /west one bit of the command of a robot is another."""
    change = partial(last_command, namespace="/west")
    return rewritten(run, tmp_path_factory.mktemp("merged") / "two.mcap", change, namespaces=SWARMS)


def place(difference: dict[str, Any]) -> list[Any]:
    return [difference[name] for name in ("topic", "step", "agent", "field")]


@pytest.mark.system
def test_verify_and_report(bag: Path, run: Path) -> None:
    east = document("verify", bag, "--namespace", "/east")
    assert east["complete"]
    assert east["digest"] == document("verify", run)["digest"]
    west = document("verify", bag, "--namespace", "west", code=1)
    assert place(west["first_difference"]) == CHANGED
    shown = {name: document("report", bag, "--png", f"{name}.png", "--namespace", name) for name in ("east", "west")}
    assert shown["east"]["digest"] == east["digest"] != shown["west"]["digest"]


def test_compare_two_swarms_of_one_bag(bag: Path, run: Path) -> None:
    found = document("compare", bag, bag, "--namespace", "/east", "--namespace", "/west", code=1)
    assert place(found["first_difference"]) == CHANGED
    assert "/west/plane/state" in found["a"]["not_compared"]
    assert "/east/plane/state" in found["b"]["not_compared"]
    assert document("compare", bag, bag, "--namespace", "/west")["equal"]
    assert "--namespace" in refused("compare", bag, bag, *(["--namespace", "/west"] * 3))
    ran("compare", bag, run, "--namespace", "/east", "--namespace", "/")


def test_export(bag: Path, run: Path, here: Path) -> None:
    for name in ("east", "west"):
        ran("export", bag, "-o", name, "--namespace", name)
        ran("export", bag, "-o", f"{name}.npz", "--format", "numpy", "--namespace", name)
    ran("export", run, "-o", "run")
    tables = {name: (here / name / "agents.csv").read_text() for name in ("east", "west", "run")}
    assert tables["east"] == tables["run"]
    rows = [list(csv.reader(tables[name].splitlines())) for name in ("east", "west")]
    assert [line for line, (a, b) in enumerate(zip(*rows, strict=True)) if a != b] == [4 * STEP + AGENT]
    with np.load("east.npz") as east, np.load("west.npz") as west:
        differ = np.argwhere(east["agents_command"] != west["agents_command"])
    assert differ.tolist() == [[STEP, AGENT - 1]]


def test_verify_a_node(bag: Path) -> None:
    words = ("verify", bag, "--node", f"agent:{AGENT}")
    assert document(*words, "--namespace", "/east")["ok"]
    found = document(*words, "--namespace", "/west", code=1)
    assert place(found["first_difference"]) == CHANGED


@pytest.mark.parametrize(
    "words",
    [
        ("verify",),
        ("compare", "{bag}"),
        ("export", "-o", "new"),
        ("export", "-o", "new.npz", "--format", "numpy"),
        ("replay", "--node", "plane"),
        ("report", "-o", "new"),
    ],
)
def test_none_or_a_wrong_name_is_refused_with_those_that_there_are(bag: Path, words: tuple[str, ...]) -> None:
    command = [words[0], bag, *(word.format(bag=bag) for word in words[1:])]
    assert "contains several swarms; select one with --namespace: /east, /west" in refused(*command)
    wrong = refused(*command, "--namespace", "/north\x1b")
    assert r"contains no swarm in the namespace /north\x1b; its swarms: /east, /west" in wrong


def test_of_different_scenarios_none_is_taken_for_that_of_a_swarm(run: Path, here: Path) -> None:
    text = (run / "scenario.yaml").read_bytes()
    other = text.replace(b"duration: 0.3", b"duration: 0.4")
    same = rewritten(run, here / "a.mcap", namespaces=SWARMS, more={"scenario.yaml": text})
    ran("verify", same, "--namespace", "/east")
    two = rewritten(run, here / "b.mcap", namespaces=SWARMS, more={"scenario.yaml": other})
    assert "contains several scenarios" in refused("verify", two, "--namespace", "/east")


def test_info_says_which_swarms_there_are_and_a_run_is_of_one(bag: Path) -> None:
    found = document("info", bag)
    assert (found["namespace"], found["swarms"]) == (None, ["/east/", "/west/"])
    assert re.search(r"^swarms in +/east, /west *$", ran("info", bag).out, re.MULTILINE)
    for command in ("run", "simulate"):
        assert "contains several swarms, but a run has only one; run the scenario.yaml" in refused(command, bag)
    assert document("scenario", "show", bag)["name"] == "pd_het_4"
