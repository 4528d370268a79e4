"""The commands that need no run of many processes, as a user types them."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from swarmabs_cli import main
from swarmabs_config.scenario import dump_scenario, json_schema, load_scenario, parse_scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_run.orchestration.run_files import write_network

KEYS = {
    *("scenario", "steps", "duration", "wall_time", "real_time_factor", "agents", "settled_at", "final_error"),
    *("rms_error", "max_abs_position", "messages", "digest", "status"),
}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def output(capfd: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    """Run a command and return what it printed."""
    assert main(list(words)) == code
    return capfd.readouterr().out


def document(capfd: pytest.CaptureFixture[str], *words: str, code: int = 0) -> Any:
    """Run a command and return the one JSON document that it printed."""
    return json.loads(output(capfd, *words, "--json", code=code), parse_constant=pytest.fail)


def test_simulate_prints_the_summary_and_leaves_the_folder(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    found = document(capfd, "simulate", "--duration", "0.2", "-o", "out")
    assert found.keys() >= KEYS
    assert (found["scenario"], found["steps"], found["agents"], found["status"]) == ("pd_het_4", 20, 4, "ok")
    assert found == json.loads((here / "out" / "summary.json").read_text())
    assert {path.name for path in (here / "out").iterdir()} == {"bag", "logs", "scenario.yaml", "summary.json"}


def test_without_a_folder_one_is_made_and_its_path_printed(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    for number in (1, 2):
        assert f"runs/pd_si_4-00{number}" in output(capfd, "simulate", "pd_si_4", "--duration", "0.1")
    assert sorted(path.name for path in (here / "runs").iterdir()) == ["pd_si_4-001", "pd_si_4-002"]


def test_without_a_bag(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    with_bag = document(capfd, "simulate", "--duration", "0.2", "-o", "a")
    without = document(capfd, "simulate", "--duration", "0.2", "--no-bag", "-o", "b")
    assert with_bag["digest"] == without["digest"]
    assert not (here / "b" / "bag").exists()


def test_warnings_go_to_standard_error(capfd: pytest.CaptureFixture[str]) -> None:
    main(["simulate", "--duration", "0.1", "-o", "out", "--json"])
    captured = capfd.readouterr()
    json.loads(captured.out)
    assert "warning: manifold" in captured.err


def test_a_failed_run_has_exit_code_1_and_says_why(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    words = ["simulate", "pd_si_4", "--set", "plane.disturbance={amplitude: 500, angular_frequency: 1}", "-o", "out"]
    assert main([*words, "--json"]) == 1
    captured = capfd.readouterr()
    found = json.loads(captured.out)
    assert (found["status"], found["real_time_factor"]) == ("failed", None)
    assert "error: step " in captured.err
    assert found == json.loads((here / "out" / "summary.json").read_text())


def test_scenarios_are_listed(capfd: pytest.CaptureFixture[str]) -> None:
    rows = document(capfd, "scenario", "list")
    assert [row["name"] for row in rows] == list(builtin_scenarios())
    (large,) = [row for row in rows if row["name"] == "arise_het_200"]
    assert (large["single_integrators"], large["double_integrators"], large["duration"]) == (100, 100, 40.0)
    text = output(capfd, "scenario", "list")
    assert all(name in text for name in builtin_scenarios())


@pytest.mark.parametrize("name", ["pd_het_4", "arise_het_20"])
def test_a_scenario_is_shown_so_that_it_can_be_run(capfd: pytest.CaptureFixture[str], name: str) -> None:
    resolved = load_scenario(builtin_scenarios()[name]).resolved()
    text = output(capfd, "scenario", "show", name)
    assert text == dump_scenario(resolved)
    assert parse_scenario(text) == resolved
    shown = document(capfd, "scenario", "show", name, "--set", "plane.angle=0.2")
    assert shown["plane"]["angle"] == 0.2
    assert len(shown["swarm"]["agents"]) == len(resolved.agents)


def test_the_schema_is_a_json_schema_of_scenarios(capfd: pytest.CaptureFixture[str]) -> None:
    schema = json.loads(output(capfd, "scenario", "schema"))
    assert schema == json_schema()
    assert set(schema["required"]) == {"schema", "swarm"}
    assert {"plane", "manifold", "controller", "faults"} <= schema["properties"].keys()


@pytest.mark.parametrize("way", ["out", "out/bag", "out/bag/bag_0.mcap"])
def test_info_says_what_a_bag_holds(capfd: pytest.CaptureFixture[str], way: str) -> None:
    main(["simulate", "--duration", "0.2", "-o", "out"])
    capfd.readouterr()
    text = output(capfd, "info", way)
    assert "swarm/agent_state" in text
    assert isinstance(document(capfd, "info", way), dict)
    assert len(document(capfd, "info", way, way)) == 2


def test_a_bag_is_split_repaired_and_run_again(capfd: pytest.CaptureFixture[str], here: Path) -> None:
    whole = document(capfd, "simulate", "--duration", "2", "-o", "whole")
    split = document(capfd, "simulate", "--duration", "2", "--max-bag-duration", "1", "-o", "split")
    assert split["digest"] == whole["digest"]
    assert sorted(path.name for path in (here / "split/bag").glob("*.mcap")) == [f"bag_{n}.mcap" for n in range(3)]
    assert "split is whole: nothing to do" in output(capfd, "repair", "split")

    os.truncate(here / "split/bag/bag_1.mcap", 10_000)
    found = document(capfd, "repair", "split")
    assert Path(found["output"]) == here / "split/bag_repaired"
    assert (found["last_complete_step"], found["last_planned_step"]) == (99, 200)
    assert found["lost_bytes"] > 0
    text = output(capfd, "repair", "split", "-o", "new")
    assert "bag_1.mcap: at byte " in text
    assert "steps 0 to 99 are complete, of 0 to 200" in text
    assert text.endswith(f"{found['messages']} messages are in new\n")
    assert document(capfd, "simulate", "new", "-o", "again")["digest"] == whole["digest"]
    assert main(["repair", "split", "-o", "new"]) == main(["repair", "nothing"]) == 2
    os.truncate(here / "whole/bag/bag_0.mcap", 0)
    assert main(["repair", "whole"]) == 1


def test_env_prints_what_a_shell_needs(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/a b/$HOME'x:/c")
    text = output(capfd, "env")
    shown = subprocess.run(
        ["sh", "-c", f'{text}\nprintf %s "$AMENT_PREFIX_PATH"'], capture_output=True, text=True, check=True
    )
    assert shown.stdout == "/a b/$HOME'x:/c"
    assert document(capfd, "env")["AMENT_PREFIX_PATH"] == "/a b/$HOME'x:/c"
    assert all(shlex.split(line)[0] == "export" for line in text.splitlines())


def test_env_of_a_run_leaves_a_sourced_ros_usable(
    capfd: pytest.CaptureFixture[str], here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (here / "logs").mkdir()
    write_network(here / "logs", 7, 3)
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/co/install:/co/.venv")
    without = document(capfd, "env", ".")
    assert (without["AMENT_PREFIX_PATH"], without["ROS_DOMAIN_ID"]) == ("/co/install:/co/.venv", "7")
    assert "PATH" in without
    monkeypatch.setenv("SWARMABS_SOURCED_AMENT_PREFIX_PATH", "/opt/ros/jazzy:/co/install")
    sourced = document(capfd, "env", ".")
    assert (sourced["AMENT_PREFIX_PATH"], sourced["ROS_DOMAIN_ID"]) == ("/opt/ros/jazzy:/co/install", "7")
    assert not {"PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "ROS_DISTRO"} & sourced.keys()
    assert document(capfd, "env")["AMENT_PREFIX_PATH"] == "/co/install:/co/.venv"


def test_env_of_a_simulated_run_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    main(["simulate", "--duration", "0.1", "-o", "out"])
    capfd.readouterr()
    assert main(["env", "out"]) == 2
    assert "not the folder of a run with processes (" in capfd.readouterr().err


def test_doctor_finds_this_machine_fit(capfd: pytest.CaptureFixture[str]) -> None:
    assert "BAD" not in output(capfd, "doctor")
    assert {finding["verdict"] for finding in document(capfd, "doctor")} <= {"ok", "note"}


@pytest.mark.parametrize(
    "command",
    [[], ["run"], ["simulate"], ["info"], ["scenario"], ["scenario", "show"], ["env"], ["doctor"], ["test"]],
)
def test_help_is_there(capfd: pytest.CaptureFixture[str], command: list[str]) -> None:
    text = output(capfd, *command, "--help")
    assert text.startswith("Usage: swarm")
    assert output(capfd, *command, "-h") == text


def test_help_names_the_contracts_options(capfd: pytest.CaptureFixture[str]) -> None:
    for command in ("run", "simulate"):
        text = output(capfd, command, "--help")
        assert all(option in text for option in ("-o", "--set", "--duration", "--no-bag", "--json"))
    assert "--full" in output(capfd, "test", "--help")


@pytest.mark.parametrize("words", [["scenario", "list"], ["scenario", "schema"], ["doctor"], ["run", "--help"]])
def test_a_reader_that_goes_away_is_no_traceback(words: list[str]) -> None:
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "swarmabs_cli", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read().decode()
        code = process.wait(15)
    assert "Traceback" not in errors
    assert "Exception ignored" not in errors
    assert code in {0, 1}


def test_the_command_starts_quickly_because_it_loads_nothing() -> None:
    program = (
        "import sys; from swarmabs_cli import main; main(['--help']);"
        "print(sorted({'rclpy', 'numpy', 'pydantic', 'rich', 'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=os.environ, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
