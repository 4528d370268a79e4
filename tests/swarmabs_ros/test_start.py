"""No node enters the middleware by a profile that Fast DDS cannot use: it would listen on every interface."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import rclpy
from tests.processes import ROOT

from abstraction_observer import node as observer, realtime as realtime_observer
from agent_node import node as agent, realtime as realtime_agent
from parent_controller import node as controller, realtime as realtime_controller
from plane_sim import driver as plane_driver, node as plane, realtime as realtime_plane
from swarmabs_bag.recorder import node as recorder, realtime as realtime_recorder
from swarmabs_core.errors import InputError
from swarmabs_fleet import discovery_server
from swarmabs_ros.start import PROFILES, check_profiles
from swarmabs_view.visualization import node as markers

MAINS: dict[str, Callable[[list[str] | None], int]] = {
    module.__name__: module.main
    for module in (
        *(observer, agent, controller, plane, recorder, markers),
        *(realtime_observer, realtime_agent, realtime_controller, realtime_plane, realtime_recorder),
        *(plane_driver, discovery_server),
    )
}


@pytest.fixture
def never(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let it be an error to start rclpy."""

    def init(*_: object, **__: object) -> None:
        raise AssertionError("rclpy was started")

    monkeypatch.setattr(rclpy, "init", init)


@pytest.mark.usefixtures("never")
@pytest.mark.parametrize("variable", PROFILES)
@pytest.mark.parametrize("name", MAINS)
def test_a_node_does_not_start_without_the_profile_it_is_told_to_use(
    name: str, variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for other in PROFILES:
        monkeypatch.delenv(other, raising=False)
    monkeypatch.setenv(variable, str(tmp_path / "robot.xml"))
    assert MAINS[name](["--ros-args", "--disable-external-lib-logs"]) == 2
    text = capfd.readouterr().err
    assert text.startswith(f"error: {variable}: {tmp_path}/robot.xml cannot be read: No such file or directory, and ")
    assert "install.sh" in text and text.count("\n") == 1


@pytest.mark.parametrize(
    "text", ["", "<dds>", "<dds></profiles>", "nonsense", '<?xml version="1.0" encoding="?"?><a/>']
)
def test_what_is_no_xml_is_refused(text: str, tmp_path: Path) -> None:
    profile = tmp_path / "robot.xml"
    profile.write_text(text)
    with pytest.raises(InputError, match=r"robot\.xml is no XML: .*every interface.*; make it anew"):
        check_profiles({PROFILES[1]: str(profile)})


def test_without_a_name_there_is_nothing_to_check(tmp_path: Path) -> None:
    profile = tmp_path / "robot.xml"
    profile.write_text("<dds/>")
    check_profiles({})
    check_profiles(dict.fromkeys(PROFILES, ""))
    check_profiles(dict.fromkeys(PROFILES, str(profile)))


@pytest.mark.parametrize("readable", [True, False])
def test_a_program_of_a_drivers_own_can_ask_beforehand(readable: bool, tmp_path: Path) -> None:  # noqa: FBT001
    profile = tmp_path / "driver.xml"
    profile.write_text("<dds/>")
    profile.chmod(0o644 if readable else 0)
    program = (
        "import sys; from tests.privileges import respect_permissions; respect_permissions(); "
        "from swarmabs_ros.start import main; sys.exit(main())"
    )
    environment = {**os.environ, "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}", PROFILES[0]: str(profile)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False, cwd=ROOT
    )
    if readable:
        assert (done.returncode, done.stderr) == (0, "")
    else:
        assert done.returncode == 2
        assert f"{PROFILES[0]}: {profile} cannot be read: Permission denied, and Fast DDS would listen" in done.stderr
