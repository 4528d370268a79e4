"""What every program of a node has in common: exit codes, error lines, settings, whom to wait for.

None enters the middleware by a profile that Fast DDS cannot use: it would listen on every interface.
"""

import importlib
import re
from pathlib import Path

import pytest
import rclpy
from tests.processes import ROOT, programs
from tests.swarmabs_ros.nodes import COMMAND_LINE, given, settings_from

from parent_controller import node as controller
from swarmabs_config.graph import CONTROLLER, LOCKSTEP, NODES, OBSERVER, PLANE, RECORDER, ROBOT
from swarmabs_core.errors import InputError
from swarmabs_core.manifold import Manifold
from swarmabs_core.models import ControllerConfig
from swarmabs_ros.settings import LockstepSettings
from swarmabs_ros.start import PROFILES, check_profiles, main

PROGRAMS = [program for path in sorted((ROOT / "src").glob("*/setup.cfg")) for program in programs(path.parent.name)]
MODULES = [module for node in NODES.values() for module in node.modules.values()]
MODULES += ["swarmabs_view.visualization.node", "swarmabs_fleet.discovery_server"]

MAINS = {
    name: importlib.import_module(NODES[name].modules[LOCKSTEP]).main
    for name in (PLANE, OBSERVER, CONTROLLER, ROBOT, RECORDER)
}


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("name", "parameters", "named"),
    [
        ("plane_sim", {"inertia": "-0.5"}, "inertia"),
        ("plane_sim", {"members": "[1, 70000]"}, "members"),
        ("plane_sim", {"schedule": "['kill 3']"}, "kill 3"),
        ("abstraction_observer", {"on_stall": "shrug"}, "on_stall"),
        ("parent_controller", {"controller__type": "mpc"}, "mpc"),
        ("parent_controller", {"controller__gains": "[1.0]"}, "controller.gains"),
        ("agent_node", {"agent_id": "0"}, "agent_id"),
        ("agent_node", {"damping": "1.0"}, "damping"),
        ("agent_node", {"kind": "wheel"}, "kind"),
        *(("plane_sim", {"match": f"['{text}']"}, "match") for text in ("x", "swarm/nothing 4", "swarm/events many")),
        ("recorder", {}, "scenario_file"),
        ("recorder", {"scenario_file": "/nowhere/scenario.yaml"}, "/nowhere/scenario.yaml"),
        *((name, {"period_ns": "0"}, "period_ns") for name in MAINS),
    ],
)
def test_a_wrong_parameter_is_refused_with_exit_code_2_and_one_line(
    name: str, parameters: dict[str, str], named: str, capfd: pytest.CaptureFixture[str]
) -> None:
    code = MAINS[name]([*COMMAND_LINE, *given(**parameters)])
    output = capfd.readouterr()
    assert (code, output.out, output.err.count("\n")) == (2, "", 1)
    assert output.err.startswith("error: ") and named in output.err


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize("name", MAINS)
@pytest.mark.parametrize("words", [["--no-such-flag"], ["-p", "mass"], ["-p", "x:=[1, 2.0]"]])
def test_a_wrong_command_line_is_refused_too(name: str, words: list[str], capfd: pytest.CaptureFixture[str]) -> None:
    assert MAINS[name](["--ros-args", *words]) == 2
    (line,) = [line for line in capfd.readouterr().err.splitlines() if not re.match(r"\[ERROR\] .* \[rcl\]", line)]
    assert line.startswith(f"error: command line of {name}: ")


def test_a_configuration_is_made_of_the_settings_of_its_parts_and_a_run_may_have_no_end() -> None:
    told = [settings_from((), last_step=step).declared(LockstepSettings) for step in (-1, 0, 3000)]
    assert [settings.last_step for settings in told] == [None, 0, 3000]
    settings = settings_from(controller.PARAMETERS, plane__inertia=0.7, manifold__offset=0.3, controller__type="lqr")
    config = settings.declared(ControllerConfig)
    assert (config.law.inertia, config.manifold) == (0.7, Manifold(offset=0.3))
    assert (config.law.controller, set(config.law.controller_settings)) == ("lqr", {"q", "r"})


@pytest.mark.parametrize("variable", PROFILES)
@pytest.mark.parametrize("module", MODULES)
def test_a_node_does_not_start_without_the_profile_it_is_told_to_use(
    module: str, variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(rclpy, "init", lambda *_, **__: pytest.fail("rclpy was started"))
    for other in PROFILES:
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(variable, str(tmp_path / "robot.xml"))
    assert importlib.import_module(module).main(COMMAND_LINE) == 2
    text = capfd.readouterr().err
    assert text.startswith(f"error: {variable}: {tmp_path}/robot.xml cannot be read: No such file or directory, and ")
    assert "install.sh" in text and text.count("\n") == 1


@pytest.mark.parametrize(
    "text", ["", "<dds>", "<dds></profiles>", "nonsense", '<?xml version="1.0" encoding="?"?><a/>']
)
def test_what_is_no_xml_is_refused(text: str, tmp_path: Path) -> None:
    profile = tmp_path / "robot.xml"
    profile.write_text(text)
    check_profiles(dict.fromkeys(PROFILES, ""))  # without a name there is nothing to check
    with pytest.raises(InputError, match=r"robot\.xml is not XML: .*every interface.*; recreate it"):
        check_profiles({PROFILES[1]: str(profile)})


@pytest.mark.parametrize("text", ["<dds/>", "<dds>"])
def test_a_program_of_a_drivers_own_can_ask_beforehand(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    profile = tmp_path / "driver.xml"
    profile.write_text(text)
    monkeypatch.setenv(PROFILES[0], str(profile))
    assert main() == (0 if text == "<dds/>" else 2)
    error = capfd.readouterr().err
    assert error == "" if text == "<dds/>" else error.startswith(f"error: {PROFILES[0]}: {profile} ")


def test_every_node_has_a_program_for_lockstep_and_one_for_real_time_that_can_be_loaded() -> None:
    names = {program.name for program in PROGRAMS}
    for node in ("plane_sim", "abstraction_observer", "parent_controller", "agent_node"):
        assert {node, f"{node}_realtime"} <= names
    assert [program.name for program in PROGRAMS if not callable(program.load())] == []
