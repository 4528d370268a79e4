"""The command check for parent systems other than the plane."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.systems import BEAM_SCENARIO

from swarmabs_cli.study.check import check as command


@pytest.mark.usefixtures("systems")
def test_the_command_prints_the_report_and_exits_by_it(tmp_path: Path) -> None:
    path = tmp_path / "beam.yaml"
    path.write_text(BEAM_SCENARIO, encoding="utf-8")
    runner = CliRunner()
    done = runner.invoke(command, [str(path), "--all", "--strict", "--duration", "1"], standalone_mode=False)
    assert done.return_value == 0
    assert done.output.startswith("beam: beam with single integrators\ncovered: ")
    assert "spectral radius of one step at rest < 1" in done.output
    bad = [str(path), "--set", "system.integral=20", "--strict", "--json", "--duration", "1"]
    done = runner.invoke(command, bad, standalone_mode=False)
    assert done.return_value == 1
    found = json.loads(done.output)
    assert (found["covered"], found["failed"]) == (False, ["GeneralStability.V_p", "sampled_time.loop"])
    assert found["angle_max"] is None


@pytest.mark.usefixtures("systems")
@pytest.mark.system
def test_what_could_not_be_evaluated_is_said_with_the_reason_and_is_not_covered(tmp_path: Path) -> None:
    path = tmp_path / "beam.yaml"
    path.write_text(BEAM_SCENARIO.replace("beam", "faulty, fault: far_out"), encoding="utf-8")
    runner = CliRunner()
    done = runner.invoke(command, [str(path)], standalone_mode=False)
    assert done.return_value == 0
    first = " ".join(done.output.splitlines()[1:3])
    reason = "GeneralConstrainedStability: completion: ValueError: too far out (systems_of_tests.py:"
    assert first.startswith(f"could not be evaluated: {reason}")
    done = runner.invoke(command, [str(path), "--strict", "--json"], standalone_mode=False)
    assert done.return_value == 1
    found = json.loads(done.output)
    assert (found["verdict"], found["covered"], found["failed"]) == ("could not be evaluated", False, [])
    assert found["not_evaluated"] == ["GeneralConstrainedStability.completion"]
