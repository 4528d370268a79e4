"""A workspace that is built from source under an installed ROS 2, as the documentation says, has all it needs."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.docs.pages import blocks, read, section
from tests.frozen.digests import CASES
from tests.processes import ROOT
from tests.scripts.installed_ros import DEBIAN, make_underlay

STAND_IN = f'env -u PYTHONPATH "{sys.executable}" -m tests.scripts.installed_ros "$VIRTUAL_ENV"'
PIP = f'pip() {{ (cd "{ROOT}" && {STAND_IN} "$@"); }}'
TESTED = "swarmabs_bringup swarmabs_msgs plane_sim"
"""Packages of both kinds whose tests are quick."""
ACTIVATE = ". /opt/ros/jazzy/setup.bash; . ~/swarmabs-venv/bin/activate"
NOT_CLONED = (".*_cache", ".git", ".hypothesis", ".venv", "__pycache__", "build", "install", "log", "runs")
DIGEST = CASES["pd_het_4"]["summary"]["digest"]


def documented(page: str, heading: str, *, holding: str) -> str:
    """Return the block of commands below a heading, for pip's stand-in, which copies what is installed here."""
    found = next(block for block in blocks(section(read(page), heading), "sh") if holding in block)
    return found.replace("python3 -m pip install", "pip")


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A home folder with a checkout, an installed ROS, and a Python that has nothing more than colcon."""
    folder = tmp_path_factory.mktemp("home")
    make_underlay(folder / "ros")
    shutil.copytree(ROOT, folder / "checkout", symlinks=True, ignore=shutil.ignore_patterns(*NOT_CLONED))
    (folder / "bin").mkdir()
    (folder / "bin" / "python3").symlink_to(Path(sys.executable).resolve())
    return folder


def run(home: Path, text: str) -> str:
    """Run commands in a shell that knows nothing of this environment; return what they print."""
    variables = {"HOME": str(home), "PATH": f"{home / 'bin'}:/usr/bin:/bin"}
    commands = f"{PIP}\n{text}".replace("/opt/ros/jazzy", str(home / "ros"))
    done = subprocess.run(
        ["bash", "-ec", commands], cwd=home / "checkout", env=variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-5000:]
    return done.stdout


@pytest.mark.full
@pytest.mark.timeout(1800)
def test_documented_commands_build_test_and_run(home: Path) -> None:
    ros = "With an installed ROS 2"
    entered, requirements, rest = documented("docs/how-to/ros.md", ros, holding="colcon build").partition("pip ")
    assert DIGEST in run(home, f"{entered}\npip {' '.join(DEBIAN)}\n{requirements}{rest}")
    test = documented("CONTRIBUTING.md", "In a colcon workspace", holding="colcon test")
    test = test.replace("colcon test\n", f"colcon test --packages-select {TESTED}\n")
    told = run(home, f"{ACTIVATE}; . install/local_setup.bash\n{test}")
    assert re.search(r"Summary: [1-9]\d* tests, 0 errors, 0 failures", told), told
    sourced = documented("docs/how-to/ros.md", ros, holding="SWARMABS_USE_SOURCED_ROS")
    assert DIGEST in run(home, f"{ACTIVATE}\n{sourced}")
