"""What every node's main has in common: exit codes, error lines, settings, whom to wait for."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from tests.swarmabs_ros.nodes import given, settings_from

from abstraction_observer import node as observer
from agent_node import node as agent
from parent_controller import node as controller
from plane_sim import node as plane
from swarmabs_bag.recorder import node as recorder
from swarmabs_core.behaviours import ControllerConfig
from swarmabs_core.errors import InputError
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import AGENT_STATE, EVENTS
from swarmabs_ros.runner import _expected

MAINS: dict[str, Callable[[list[str] | None], int]] = {
    "plane_sim": plane.main,
    "abstraction_observer": observer.main,
    "parent_controller": controller.main,
    "agent_node": agent.main,
    "recorder": recorder.main,
}

every_node = pytest.mark.parametrize("name", MAINS)


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("name", "parameters", "named"),
    [
        ("plane_sim", {"inertia": "-0.5"}, "inertia"),
        ("plane_sim", {"friction": "[0.1, 0.2]"}, "friction"),
        ("plane_sim", {"members": "[1, 70000]"}, "members"),
        ("plane_sim", {"schedule": "['kill 3']"}, "kill 3"),
        ("abstraction_observer", {"on_stall": "shrug"}, "on_stall"),
        ("abstraction_observer", {"gravity": ".nan"}, "gravity"),
        ("parent_controller", {"controller__type": "pid"}, "pid"),
        ("parent_controller", {"controller__gains": "[1.0]"}, "controller.gains"),
        ("parent_controller", {"recording_window": "-1"}, "recording_window"),
        ("agent_node", {"mass": "0.0"}, "mass"),
        ("agent_node", {"agent_id": "0"}, "agent_id"),
        ("agent_node", {"damping": "1.0"}, "damping"),
        ("agent_node", {"kind": "wheel"}, "kind"),
        ("recorder", {}, "scenario_file"),
        ("recorder", {"scenario_file": "/nowhere/scenario.yaml"}, "/nowhere/scenario.yaml"),
        *((name, {"period_ns": "0"}, "period_ns") for name in MAINS),
        *((name, {"receive": "pigeon"}, "receive") for name in MAINS),
    ],
)
def test_a_wrong_parameter_is_refused_with_exit_code_2_and_one_line(
    name: str, parameters: dict[str, str], named: str, capfd: pytest.CaptureFixture[str]
) -> None:
    code = MAINS[name](["--ros-args", "--disable-external-lib-logs", *given(**parameters)])
    output = capfd.readouterr()
    assert code == 2
    assert output.out == ""
    assert output.err.count("\n") == 1
    assert output.err.startswith("error: ")
    assert named in output.err


@pytest.mark.usefixtures("ros")
@every_node
@pytest.mark.parametrize("words", [["--no-such-flag"], ["-p", "mass"], ["-p", "x:=[1, 2.0]"]])
def test_a_wrong_command_line_is_refused_too(name: str, words: list[str], capfd: pytest.CaptureFixture[str]) -> None:
    assert MAINS[name](["--ros-args", *words]) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if not re.match(r"\[ERROR\] .* \[rcl\]", line)]
    assert len(lines) == 1
    assert lines[0].startswith(f"error: command line of {name}: ")


def test_who_is_waited_for() -> None:
    assert _expected(settings_from((), match=())) == {}
    found = _expected(settings_from((), match=("swarm/agent_state 4", "swarm/events 2")))
    assert found == {AGENT_STATE: 4, EVENTS: 2}


@pytest.mark.parametrize("text", ["swarm/agent_state", "swarm/nothing 4", "swarm/events many", ""])
def test_whom_nobody_can_wait_for(text: str) -> None:
    with pytest.raises(InputError, match="parameter match"):
        _expected(settings_from((), match=(text,)))


@pytest.mark.parametrize(("value", "step"), [(-1, None), (0, 0), (3000, 3000)])
def test_a_run_may_have_no_end(value: int, step: int | None) -> None:
    assert settings_from((), last_step=value).last_step() == step


def test_a_configuration_is_made_of_the_settings_of_its_parts() -> None:
    settings = settings_from(controller.PARAMETERS, plane__inertia=0.7, manifold__offset=0.3, controller__type="lqr")
    config = settings.made(ControllerConfig)
    assert (config.law.inertia, config.manifold) == (0.7, Manifold(offset=0.3))
    assert (config.law.controller, set(config.law.controller_settings)) == ("lqr", {"q", "r"})
