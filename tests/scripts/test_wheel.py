"""The wheel of what needs no ROS: what is in it, what it imports, and what it does in an environment of its own."""

import json
import os
import re
import shlex
import subprocess
import sys
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.version import Version
from scripts.build_wheel import PACKAGES, build
from tests.frozen.digests import CASES
from tests.portability.machines import SERIES, interpreter, variables
from tests.processes import ROOT

from swarmabs_bag.run.channels import RECORDED_TYPES
from swarmabs_config.installation import EXTRAS
from swarmabs_config.scenarios import builtin_scenarios

WORKSPACE = ("abstraction_observer", "agent_node", "parent_controller", "plane_sim", "swarmabs_ros", "swarmabs_msgs")
ROS = ("rclpy", "rosidl_runtime_py", "rosidl_parser", "rpyutils", "ament_index_python", "launch", "rcl_interfaces")
MESSAGES = ("builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "rosgraph_msgs", "sensor_msgs", "std_msgs")
HIDDEN = (*WORKSPACE, *ROS, *MESSAGES, "std_srvs", "visualization_msgs")
NEED_ROS = {"bags.markers", "bags.replay", "fleet.operate", "run.demo", "run.run"}
"""The files of the commands that need ROS whatever their options."""
LARGEST = 150e6
"""Size of an environment with the wheel and what it requires, bytes, without what installs it."""
INSTALLERS = {"pip", "pkg_resources", "setuptools"}
pytestmark = [pytest.mark.system, pytest.mark.timeout(600)]

DIGEST = CASES["pd_het_4"]["summary"]["digest"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("dist"))


@pytest.fixture(scope="module")
def unpacked(wheel: Path) -> Path:
    folder = wheel.parent / "unpacked"
    with ZipFile(wheel) as file:
        file.extractall(folder)
    return folder


def metadata(wheel: Path) -> Message:
    with ZipFile(wheel) as file:
        (name,) = (name for name in file.namelist() if name.endswith(".dist-info/METADATA"))
        return message_from_bytes(file.read(name))


def test_the_same_sources_give_the_same_bytes(wheel: Path, tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        assert build(tmp_path).read_bytes() == wheel.read_bytes()
    finally:
        os.umask(before)


def test_it_holds_the_sources_and_their_data_and_nothing_of_ros(wheel: Path) -> None:
    with ZipFile(wheel) as file:
        names = set(file.namelist())
    tops = {name.partition("/")[0] for name in names}
    assert tops == {*PACKAGES, f"swarmabs-{metadata(wheel)['Version']}.dist-info"}
    for package in PACKAGES:
        sources = ROOT / "src" / package
        files = (path for path in (sources / package).rglob("*") if path.is_file() and "__pycache__" not in path.parts)
        assert {path.relative_to(sources).as_posix() for path in files} <= names
    share = "swarmabs_config/wheel/share"
    assert {f"{share}/swarmabs_bringup/scenarios/{name}.yaml" for name in builtin_scenarios()} <= names
    for name in RECORDED_TYPES:
        assert {f"{share}/{name}.msg", f"{share}/{name}.json"} <= names
    assert "swarmabs_view/third_party/uplot/LICENSE" in names


def test_metadata_admits_what_the_locks_pin(wheel: Path) -> None:
    told = metadata(wheel)
    assert wheel.name == f"swarmabs-{told['Version']}-py3-none-any.whl"
    assert told["Requires-Python"] == ">=3.10"
    locks = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "scripts" / "requirements").glob("*.lock"))
    for text in told.get_all("Requires-Dist", []):
        requirement = Requirement(text)
        if requirement.name != "swarmabs":
            pinned = re.findall(rf"(?im)^{re.escape(requirement.name)}==([\w.]+)", locks)
            assert pinned, f"{requirement.name} is in no lock"
            assert all(requirement.specifier.contains(Version(version)) for version in pinned), text
    extras = told.get_all("Provides-Extra", [])
    assert set(EXTRAS.values()) | {"all", "reports"} == set(extras)
    for module, extra in EXTRAS.items():
        assert any(
            Requirement(text).name == module and f'extra == "{extra}"' in text
            for text in told.get_all("Requires-Dist", [])
        )


def test_twine_accepts_it(wheel: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "twine", "check", "--strict", str(wheel)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_only_commands_that_need_ros_import_it(unpacked: Path) -> None:
    program = [sys.executable, str(ROOT / "tests/scripts/wheel_imports.py"), str(unpacked), *HIDDEN]
    done = json.loads(subprocess.check_output(program, env=variables(), cwd=unpacked))
    assert not {name.partition(".")[0] for name in done["loaded"]} & set(HIDDEN)
    assert set(done["missing"].values()) <= set(HIDDEN)
    failing = {name for name in done["missing"] if re.fullmatch(r"swarmabs_cli\.\w+\.\w+", name)}
    assert failing == {f"swarmabs_cli.{name}" for name in NEED_ROS}


def test_without_what_only_posix_has_everything_else_works(unpacked: Path, tmp_path: Path) -> None:
    case = CASES["sensors"]
    overrides = [f"--set={override}" for override in case["set"]]
    expected = {
        shlex.join(["simulate", case["scenario"], *overrides, "-o", "run"]): case["summary"]["digest"],
        "verify run": "agree bit for bit",
        "info run": "complete",
        "export run -o run.npz": "run.npz",
        "repair run": "nothing to repair",
        "check": "covered",
        "report run --html report.html": "report.html",
    }
    program = [sys.executable, str(ROOT / "tests/scripts/other_platform.py"), *expected]
    environment = variables() | {"PYTHONPATH": str(unpacked)}
    done = subprocess.run(program, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    position = 0
    for command, printed in expected.items():
        position = done.stdout.find(printed, position)
        assert position >= 0, f"{command}: no {printed!r} in its place\n{done.stdout}"


@pytest.mark.parametrize("series", SERIES)
def test_pip_installs_it_and_all_commands_work_or_say_what_they_need(series: str, wheel: Path, tmp_path: Path) -> None:
    python = tmp_path / "environment" / "bin" / "python"
    environment = variables()
    subprocess.run([interpreter(series), "-m", "venv", str(tmp_path / "environment")], env=environment, check=True)
    pip = [str(python), "-m", "pip", "--disable-pip-version-check"]
    reach = [*pip, "download", "--quiet", "--no-deps", "--retries=0", "--dest", str(tmp_path / "index"), "click"]
    if subprocess.run(reach, env=environment, capture_output=True, check=False).returncode:
        pytest.skip("the package index cannot be reached")
    subprocess.run([*pip, "install", "--quiet", str(wheel)], env=environment, check=True)
    installed = [path for path in (tmp_path / "environment").rglob("*") if path.is_file() and not path.is_symlink()]
    assert sum(path.stat().st_size for path in installed if not INSTALLERS & {*path.parts}) < LARGEST

    def swarm_command(words: str, code: int = 0) -> str:
        program = [str(python.with_name("swarm")), *words.split()]
        done = subprocess.run(program, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stderr if code == 2 else done.stdout

    assert swarm_command("--version") == f"swarm {metadata(wheel)['Version']}\n"
    assert DIGEST in swarm_command("simulate")
    assert "agree bit for bit" in swarm_command("verify runs/pd_het_4-001")
    assert "complete" in swarm_command("info runs/pd_het_4-001")
    assert "covered" in swarm_command("check")
    assert "[BAG]" in swarm_command("view --help")
    ros = r"error: swarm {} needs ROS 2, which this Python does not have \(no module \w+\); use .* checkout, .*\n"
    for command in ("run", "demo", "replay runs/pd_het_4-001", "markers runs/pd_het_4-001 -o m", "env", "status fleet"):
        assert re.fullmatch(ros.format(command.split()[0]), swarm_command(command, 2))
    for command, extra in (
        ("view runs/pd_het_4-001", "view"),
        ("report runs/pd_het_4-001", "plots"),
        ("sweep x", "sweeps"),
    ):
        error = swarm_command(command, 2)
        assert error.count("\n") == 1
        assert error.endswith(f'{python} -m pip install "swarmabs[{extra}]"\n')
    assert swarm_command("wheel", 2).endswith("is not in a checkout of swarmabs; change into one\n")
