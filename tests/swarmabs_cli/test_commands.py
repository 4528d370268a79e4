"""The commands that need no run of many processes, as a user types them, and the warnings before a run."""

import json
import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import click
import pytest
from tests.swarmabs_cli.conftest import document, ran, refused

from swarmabs_cli import swarm as cli
from swarmabs_cli.runs import SETUP, setup_seconds, times
from swarmabs_config.scenario import dump_scenario, json_schema, load_scenario, parse_scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_run.orchestration.run_files import since_start, write_network
from swarmabs_run.run import Outcome


def test_simulate_prints_the_summary_and_leaves_the_folder_or_makes_one(here: Path) -> None:
    found = document("simulate", "--duration", "0.2", "-o", "out")
    assert (found["scenario"], found["steps"], found["agents"], found["status"]) == ("pd_het_4", 20, 4, "ok")
    assert found == json.loads((here / "out" / "summary.json").read_text())
    assert {path.name for path in (here / "out").iterdir()} == {"bag", "logs", "scenario.yaml", "summary.json"}
    without = ran("simulate", "--duration", "0.2", "--no-bag", "-o", "b", "--json")
    assert without.document()["digest"] == found["digest"]
    assert not (here / "b" / "bag").exists()
    assert "warning" not in without.err
    for number in (1, 2):
        assert f"runs/pd_si_4-00{number}" in ran("simulate", "pd_si_4", "--duration", "0.1").out
    assert sorted(path.name for path in (here / "runs").iterdir()) == ["pd_si_4-001", "pd_si_4-002"]


def test_a_failed_run_has_exit_code_1_and_says_why(here: Path) -> None:
    words = ("simulate", "pd_si_4", "--set", "plane.disturbance={amplitude: 500, angular_frequency: 1}", "-o", "out")
    done = ran(*words, "--json", code=1)
    found = done.document()
    assert (found["status"], found["real_time_factor"]) == ("failed", None)
    assert "error: step " in done.err
    assert found == json.loads((here / "out" / "summary.json").read_text())


FLYING = ("simulate", "pd_het_4", "--duration", "0.6", "--set", "swarm.gains={k: [199, 199], kp: [20000, 20000]}")


@pytest.mark.system
def test_a_run_in_which_robots_flew_off_is_recorded_and_has_failed(here: Path) -> None:
    done = ran(*FLYING, "-o", "out", "--json", code=1)
    found = done.document()
    assert found == json.loads((here / "out" / "summary.json").read_text())
    assert (found["status"], found["settled_at"], found["steps"]) == ("failed", None, 60)
    assert found["real_time_factor"] is not None, "it is complete"
    strays = found["out_of_range"]
    assert (strays["robots"], strays["flown_off"], len(strays["first"])) == (4, 4, 4)
    assert f"error: {found['reason']}" in done.err
    where = r"position (above|below) -?0\.5 m since step 4\d, -?[\d.]+ at step 4\d"
    assert re.fullmatch(rf"robot \d flew off: {where}; 3 more robots likewise", found["reason"])
    assert found["reason"].partition(";")[0] == strays["first"][0]
    assert done.err.count("warning: step 4") == 3, "the first robots are told of during the run"
    info = document("info", "out")
    assert info["out_of_range"] == strays["first"]
    assert "flew off" in ran("info", "out").out
    assert ran("verify", "out").code == 0
    ran("report", "out", "--html", "report.html")
    page = (here / "report.html").read_text()
    assert found["reason"] in page and all(text[1:] in page for text in strays["first"])
    again = ran("simulate", "out", "-o", "again", "--json")
    assert (again.document()["status"], again.document()["digest"]) == ("ok", found["digest"]), "it repeats a run"
    assert again.err.count("flew off") == 4


def test_a_robot_that_only_touches_the_end_of_the_plane_is_a_warning() -> None:
    touching = ("simulate", "arise_di_4", "--set", "plane.length=0.28")
    done = ran(*touching, "--duration", "6", "-o", "back", "--json")
    found = done.document()
    assert (found["status"], found["reason"], found["settled_at"]) == ("ok", None, 4.76)
    assert "warning: robot 2 was out of range: position below -0.14 m, from step 36 to 65" in done.err
    assert found["out_of_range"]["flown_off"] == 0
    found = ran(*touching, "--duration", "3", "-o", "outside", "--json", code=1).document()
    assert found["reason"] == "robot 4 is out of range at the end: position below -0.14 m since step 160"
    assert found["settled_at"] is None


def test_scenarios_are_listed_and_their_schema_is_printed() -> None:
    rows = document("scenario", "list")
    assert [row["name"] for row in rows] == list(builtin_scenarios())
    (large,) = [row for row in rows if row["name"] == "arise_het_200"]
    assert (large["single_integrators"], large["double_integrators"], large["duration"]) == (100, 100, 40.0)
    text = ran("scenario", "list").out
    assert all(row[told] in text for row in rows for told in ("name", "figure", "description"))
    assert {row["figure"].split(",")[0] for row in rows} == {"PD_res", "ARISE_res", "ARISE_lg_swarm"}
    assert ran("scenario", "schema").document() == json_schema()


@pytest.mark.parametrize("name", ["pd_het_4", "arise_het_20"])
def test_a_scenario_is_shown_so_that_it_can_be_run(name: str) -> None:
    resolved = load_scenario(builtin_scenarios()[name]).resolved()
    text = ran("scenario", "show", name).out
    assert text == dump_scenario(resolved)
    assert parse_scenario(text) == resolved
    shown = document("scenario", "show", name, "--set", "plane.angle=0.2")
    assert shown["plane"]["angle"] == 0.2
    assert len(shown["swarm"]["agents"]) == len(resolved.agents)


def test_info_says_what_a_bag_holds_however_it_is_named_and_doctor_finds_this_machine_fit(run: Path) -> None:
    assert "BAD" not in ran("doctor").out
    assert {finding["verdict"] for finding in document("doctor")} <= {"ok", "note"}
    assert "swarm/agent_state" in ran("info", run).out
    found = document("info", run)
    assert document("info", run / "bag", run / "bag/bag_0.mcap") == [found, found]


def test_a_bag_is_split_repaired_and_run_again(here: Path) -> None:
    whole = document("simulate", "--duration", "2", "-o", "whole")
    split = document("simulate", "--duration", "2", "--max-bag-duration", "1", "-o", "split")
    assert split["digest"] == whole["digest"]
    assert sorted(path.name for path in (here / "split/bag").glob("*.mcap")) == [f"bag_{n}.mcap" for n in range(3)]
    assert "split is complete: nothing to repair" in ran("repair", "split").out

    os.truncate(here / "split/bag/bag_1.mcap", 10_000)
    found = document("repair", "split")
    assert Path(found["output"]) == here / "split/bag_repaired"
    assert (found["last_complete_step"], found["last_planned_step"]) == (99, 200)
    assert found["lost_bytes"] > 0
    text = ran("repair", "split", "-o", "new").out
    assert "bag_1.mcap: at byte " in text
    assert "steps 0 to 99 of 0 to 200 are complete" in text
    assert text.endswith(f"wrote {found['messages']} messages to new\n")
    assert document("simulate", "new", "-o", "again")["digest"] == whole["digest"]
    assert "new" in refused("repair", "split", "-o", "new")
    assert "nothing" in refused("repair", "nothing")
    os.truncate(here / "whole/bag/bag_0.mcap", 0)
    ran("repair", "whole", code=1)


def test_env_prints_what_a_shell_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/a b/$HOME'x:/c")
    text = ran("env").out
    shown = subprocess.run(
        ["sh", "-c", f'{text}\nprintf %s "$AMENT_PREFIX_PATH"'], capture_output=True, text=True, check=True
    )
    assert shown.stdout == document("env")["AMENT_PREFIX_PATH"] == "/a b/$HOME'x:/c"
    assert all(shlex.split(line)[0] == "export" for line in text.splitlines())


def test_env_of_a_run_leaves_a_sourced_ros_usable(here: Path, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (here / "logs").mkdir()
    write_network(here / "logs", 7, 3)
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/co/install:/co/.venv")
    without = document("env", ".")
    assert (without["AMENT_PREFIX_PATH"], without["ROS_DOMAIN_ID"]) == ("/co/install:/co/.venv", "7")
    assert "PATH" in without
    monkeypatch.setenv("SWARMABS_SOURCED_AMENT_PREFIX_PATH", "/opt/ros/jazzy:/co/install")
    sourced = document("env", ".")
    assert (sourced["AMENT_PREFIX_PATH"], sourced["ROS_DOMAIN_ID"]) == ("/opt/ros/jazzy:/co/install", "7")
    assert not {"PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "ROS_DISTRO"} & sourced.keys()
    assert document("env")["AMENT_PREFIX_PATH"] == "/co/install:/co/.venv"
    assert "not the folder of a run with processes (" in refused("env", run)


def test_each_command_has_a_summary_of_one_line_and_examples_that_parse(here: Path) -> None:
    for path in ("runs/pd_het_4-001", "examples/fleet/lan.yaml", "examples/fleet/standby.yaml"):
        (here / path).mkdir(parents=True)
    root = click.Context(cli)
    assert "..." not in ran("--help").out.partition("\nRun swarms")[2]
    for name in cli.list_commands(root):
        command = cli.get_command(root, name)
        assert command is not None and command.epilog is not None, name
        _, title, *lines = command.epilog.splitlines()
        assert title == "Examples:" and lines
        for line in lines:
            words = re.sub(r'^ *eval "\$\((.*)\)"', r"\1", line).partition(" > ")[0].split()
            assert words[:2] == ["./scripts/swarm", name]
            command.make_context(name, words[2:])


@pytest.mark.parametrize("words", [(), ("scenario",)])
def test_a_group_alone_shows_its_help(words: tuple[str, ...]) -> None:
    assert ran(*words, code=2).err.rstrip() == ran(*words, "--help").out.rstrip()


def test_the_version_is_that_of_the_packages() -> None:
    assert ran("--version").out == f"swarm {version('swarmabs_core')}\n"


@pytest.mark.parametrize("words", [["scenario", "list"], ["run", "--help"]])
def test_a_reader_that_goes_away_is_no_traceback(words: list[str]) -> None:
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "swarmabs_cli", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read().decode()
        assert process.wait(15) in {0, 1}
    assert "Traceback" not in errors and "Exception ignored" not in errors


@pytest.mark.parametrize(("told", "seconds"), [("{own}:85.25", 85.25), ("{parent}:85.25", 0.0), ("", 0.0), (None, 0.0)])
def test_only_a_fresh_process_counts_set_up(monkeypatch: pytest.MonkeyPatch, told: str | None, seconds: float) -> None:
    monkeypatch.delenv(SETUP, raising=False)
    if told is not None:
        monkeypatch.setenv(SETUP, told.format(own=os.getpid(), parent=os.getppid()))
    assert setup_seconds() == seconds
    # The start is what lies between set-up and the first step.
    startup = times(86.0, Outcome("ok", None, {}, start_seconds=1.5)).startup
    assert startup == pytest.approx(86.0 - seconds + 1.5)
    assert times(86.0, Outcome("failed", "no", {})).startup is None
    # A later run of the same command counts from its own request, and has no set-up.
    later = times(86.0, Outcome("ok", None, {}, start_seconds=1.5), begun=80.0)
    assert (later.startup, later.setup) == (pytest.approx(7.5), 0.0)
    assert 0.0 < since_start() < 3600.0


def test_the_table_of_check_names_conditions_numbers_and_verdicts() -> None:
    lines = ran("check", "arise_si_4").out.splitlines()
    assert lines[1].startswith("not covered: these conditions fail: ARISE_SI_sys: ks, friction alone")
    text, everything = (" ".join(ran("check", "arise_si_4", *words).out.split()) for words in ((), ("--all",)))
    for said in (
        "ARISE_SI_sys, ARISE with single integrators: fails (as printed: fails)",
        "corrected ks > c_max^2/(4 eta3) 1 144 -143 fails",
        "with ks = 1 the ARISE theorem does not cover this run",
    ):
        assert said in text and said in everything
    for said in ("LQR_SI_sys: not applicable, the parent controller is arise", "region of attraction"):
        assert said in everything and said not in text


def test_the_document_of_check_has_stable_names_and_null_for_what_does_not_exist() -> None:
    found = document("check", "pd_het_4")
    assert set(found) == {
        *("scenario", "controller", "swarm", "angle_max", "verdict", "covered", "failed", "not_evaluated"),
        *("theorems", "beyond_the_paper", "simulated", "losses"),
        *("attraction", "abstract_states", "notes"),
    }
    assert len(found["theorems"]) == 8
    (used,) = [one for one in found["theorems"] if one["label"] == "LQR_noHomo_sys"]
    assert set(used) == {"label", "title", "applicable", "verdict", "printed_verdict", "note", "conditions"}
    names = {"name", "printed", "corrected", "margin", "verdict", "inputs", "note"}
    assert all(set(one) == names for one in used["conditions"])
    (epsilon,) = [one for one in used["conditions"] if one["name"] == "epsilon"]
    assert epsilon["corrected"]["value"] == pytest.approx(3.077, abs=5e-4)
    assert epsilon["verdict"] == "holds"
    assert document("check", "pd_di_4", "--set", "controller.gains=[3, -2]")["attraction"]["weight"] is None


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("pd_het_4",), 0),
        (("arise_het_4",), 1),
        (("pd_si_4", "--set", "plane.angle=0.18"), 1),
        (("pd_si_4", "--set", "plane.angle=0.18", "--angle-max", "0.25"), 0),
        (("pd_si_4", "--set", "step=0.25", "--duration", "5"), 1),
    ],
)
def test_check_tells_if_it_is_strict_by_the_exit_code(words: tuple[str, ...], code: int) -> None:
    found = document("check", *words, "--strict", code=code)
    assert (bool(found["failed"]), found["covered"]) == (bool(code), not code)


@pytest.mark.parametrize(("name", "count"), [("arise_si_4", 1), ("pd_si_4", 0)])
def test_a_run_is_warned_of_in_few_lines(name: str, count: int) -> None:
    done = ran("simulate", name, "--duration", "0.1", "--json")
    json.loads(done.out)
    warnings = [line for line in done.err.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == count
    assert any("ks = 1" in line for line in warnings) == (name == "arise_si_4")


def test_ranges_are_told_in_words_under_one_name_of_the_program() -> None:
    text = " ".join(ran("run", "--help").out.split())
    assert text.startswith("Usage: ./scripts/swarm run [OPTIONS]")
    assert "[0 to 65535]" in text and "[more than 0 and at most 1000000]" in text and "<=" not in text
    error = refused("run", "--view-port", "70000")
    assert "70000 is out of range: give 0 to 65535. See ./scripts/swarm run --help." in error
    assert "'x' is not a whole number" in refused("run", "--agents-per-process", "x")
    for words in ((), ("scenario",)):
        assert "..." not in ran(*words, "--help").out.replace("[ARGS]...", "")
    assert " RUN ACTION [VALUE|ROBOT]" in ran("steer", "--help").out
