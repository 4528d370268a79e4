"""A further recorded topic is simulated, recorded, verified and exported as soon as it is declared."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.processes import ROOT, SEARCH_PATH

from swarmabs_analysis.verify import BagToVerify
from swarmabs_core.messages import PLANE_FAMILY, STANDING
from swarmabs_run.swarm_columns import only_controlled

PROGRAM = Path(__file__).with_name("further_topic.py")
STEPS = 101


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """What `further_topic.py` prints."""
    folder = tmp_path_factory.mktemp("further")
    command = [sys.executable, str(PROGRAM), str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **SEARCH_PATH}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout) | {"folder": folder}


def test_it_is_recorded_in_every_step_with_and_without_arrays(told: Any) -> None:
    assert told["on_arrays"] and told["same"]
    assert told["counts"] == [STEPS, STEPS]
    assert told["order"][-3:] == ["swarm/standing", "parent/effort", "swarm/desired_abstract_state"]
    assert set(told["complete"].values()) == {STEPS - 1} and "/parent/effort" in told["complete"]


def test_it_is_verified_without_a_change_of_the_digest(told: Any) -> None:
    for name in ("few", "many", "without"):
        assert (told[name]["ok"], told[name]["complete"], told[name]["difference"]) == (True, True, None)
    assert told["without"]["messages"] == told["few"]["messages"] - STEPS
    assert told["without"]["digest"] == told["few"]["digest"]
    assert told["without"]["notes"] == ["not checked: parent/effort, which the bag does not have"]
    assert told["changed"]["difference"] == ["parent/effort", 40, "work"]


def test_a_version_that_does_not_know_it_says_that_it_is_not_checked(told: Any) -> None:
    result = BagToVerify(told["folder"] / "few").verify()
    assert (result.ok, result.complete, result.digest) == (True, False, told["few"]["digest"])
    assert result.notes == ("not checked: /parent/effort",)


def test_it_has_a_table(told: Any) -> None:
    first, last = told["rows"]
    assert list(first) == ["step", "time", "power", "work", "stamp"]
    assert (first["work"], last["step"], last["work"]) == ("0.25", "100", "100.25")
    assert told["arrays"] == [[step + 0.25 for step in range(STEPS)]] * 3


def test_its_numbers_are_shown_with_their_units(told: Any) -> None:
    shown, without = told["page"]
    assert shown["rows"] == without["rows"] == [["effort_power", "W"], ["effort_work", "J"]]
    power = float(told["rows"][-1]["power"])
    assert (shown["values"], without["values"]) == ([power, 100.25], [None, None])
    assert shown["live"] and without["live"]
    assert told["terminal"] == [f"effort power {power:+.4g} W", "effort work +100.2 J"]


def test_arrays_leave_a_topic_of_another_node_than_the_controller_to_the_state_machines() -> None:
    assert only_controlled(PLANE_FAMILY)
    assert not only_controlled(replace(PLANE_FAMILY, further=(STANDING,)))
