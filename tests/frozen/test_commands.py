"""Every command line as before: its exit code, its JSON document, what it reads of frozen bags and makes of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.frozen import commands
from tests.frozen.command import Finished, swarm

from swarmabs_core.fingerprint import libm_fingerprints

ALONE = [name for name, case in commands.CASES.items() if "during" not in case and not case.get("over_dds")]
OVER_DDS = [name for name, case in commands.CASES.items() if case.get("over_dds")]

pytestmark = [
    pytest.mark.timeout(120),
    pytest.mark.skipif(
        "c1d491c2e05e87ee" not in libm_fingerprints(),
        reason="this machine's mathematical library is not that of the frozen bags",
    ),
]


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


@pytest.mark.parametrize("name", ALONE)
def test_a_command_is_as_before(name: str, folder: Path, names: dict[str, str]) -> None:
    check(name, commands.run_case(name, folder, names), folder)


@pytest.mark.system
@pytest.mark.parametrize("name", OVER_DDS)
def test_a_command_that_starts_processes_is_as_before(name: str, folder: Path, names: dict[str, str]) -> None:
    check(name, commands.run_case(name, folder, names), folder)


@pytest.mark.system
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


def test_a_missing_key_another_type_and_a_number_that_changes_are_seen() -> None:
    wanted = {"a": "number", "b": [{"c": "null|text"}], "d": 1.5}
    assert commands.fits({**wanted, "new": "text"}, wanted) == []
    assert commands.fits({"a": "number", "d": 1.5}, wanted) == [".b is missing"]
    assert commands.fits({**wanted, "b": [{"c": "text"}]}, wanted) == [".b[0].c: null|text was frozen, text is found"]
    assert commands.fits({**wanted, "d": 1.25}, wanted) == [".d: 1.5 was frozen, 1.25 is found"]
