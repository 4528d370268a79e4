"""Results as before: of runs, command lines (exit code, JSON document, what is made of frozen bags) and pictures."""

from pathlib import Path

import numpy as np
import pytest
from tests.frozen import commands, digests, pictures
from tests.frozen.command import Finished, swarm

DRAWING = {"report_both", "report_damaged"}
"""Cases that take seconds, of which `report` has most."""
ALONE = [
    pytest.param(name, marks=[pytest.mark.system] * (name in commands.STARTING | DRAWING))
    for name, case in commands.CASES.items()
    if "during" not in case
]
COVERED = ("sensors", "offset_and_disturbance_steps", "robot_gravity", "parent_response_pd", "join_freeze")
"""Cases whose mechanisms `everything_at_once`, or another that takes less than all, has, too."""
ALIKE = ("pd_si_4", "pd_di_4", "arise_si_4", "arise_di_4", "arise_het_20")
"""Runs of the paper of which there is one with both kinds of robots, or with more of them, as well."""
SEVERAL = ("--agents-per-process", "4")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("commands")


@pytest.fixture(scope="module")
def names(folder: Path) -> dict[str, str]:
    return commands.prepare(folder)


def check(name: str, done: Finished, folder: Path) -> None:
    """Compare how a command has ended with how it is frozen; what is refused says so in one line."""
    case = commands.CASES[name]
    found = commands.outcome(name, done, folder)
    wanted = {key: case[key] for key in ("code", "shape", "document", "tables") if key in case}
    assert commands.fits(found, wanted) == [], done.err
    if done.code == commands.REFUSED and case["words"]:
        assert done.err.splitlines()[-1].startswith("error: ")
        assert not done.out or "--json" in case["words"]


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", ALONE)
def test_a_command_is_as_before(name: str, folder: Path, names: dict[str, str]) -> None:
    check(name, commands.run_case(name, folder, names), folder)


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.parametrize("during", commands.DURING)
def test_commands_for_a_run_that_goes_on_are_as_before(during: str, folder: Path, names: dict[str, str]) -> None:
    with commands.going_on(during, folder) as run:
        for name, case in commands.CASES.items():
            if case.get("during") == during:
                check(name, commands.run_case(name, folder, {**names, "run_going_on": run}), folder)


def test_what_a_repaired_bag_holds_verifies_up_to_what_was_lost(folder: Path, names: dict[str, str]) -> None:
    """A bag of a later run with the same steps and the repaired one agree wherever there is something in both."""
    assert swarm(("repair", f"{names['data']}/damaged_1", "-o", "repaired"), folder).code == 0
    found = swarm(("compare", "repaired", f"{names['data']}/split_1", "--json"), folder).document()
    assert found["damaged"] is False
    assert {topic["differing"] for topic in found["topics"]} == {0}
    assert {topic["missing_in_b"] for topic in found["topics"]} == {0}


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.system] * (name in {*ALIKE, *COVERED})) for name in digests.CASES]
)
def test_a_simulation_gives_its_frozen_results(name: str, tmp_path: Path) -> None:
    assert digests.difference(name, digests.summary(name, tmp_path, "simulate", "--no-bag")) == {}


@pytest.mark.system
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("name", "options"),
    [
        *(pytest.param(n, SEVERAL, marks=[pytest.mark.full] * (n in COVERED)) for n in digests.chosen("run")),
        ("join_freeze", ("--packed",)),
    ],
)
def test_processes_over_dds_give_them_too(name: str, options: tuple[str, ...], tmp_path: Path) -> None:
    assert digests.difference(name, digests.summary(name, tmp_path, "run", *options)) == {}


@pytest.mark.parametrize("name", digests.FLEETS)
def test_a_fleet_in_real_time_says_the_same_at_the_same_times(name: str) -> None:
    assert digests.of_fleet(name) == digests.FLEETS[name]["found"]


@pytest.mark.system
@pytest.mark.parametrize("name", pictures.CASES)
def test_a_picture_shows_what_it_showed(name: str, tmp_path: Path) -> None:
    """Where it is meant to change: look at it, then ``python -m tests.frozen.freeze pictures``."""
    drawn, wanted = pictures.found(name, tmp_path), pictures.PICTURES[name]
    assert drawn["texts"] == wanted["texts"]
    np.testing.assert_allclose(drawn["numbers"], wanted["numbers"], rtol=1e-5, atol=1e-8)
