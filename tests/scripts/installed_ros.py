"""An installed ROS 2 as /opt/ros/jazzy is laid out, made of the wheels of this environment, and a Python without them.

``python -m tests.scripts.installed_ros PREFIX NAME...`` stands in for pip where tests have no network: it copies
packages, and all they require, from this environment.
"""

import os
import re
import shutil
import sys
from importlib.metadata import Distribution, distribution, distributions
from pathlib import Path

from packaging.requirements import Requirement

SERIES = f"python{sys.version_info.major}.{sys.version_info.minor}"
MODULES = Path("lib") / SERIES / "site-packages"
BOOTSTRAP = "ros-wheels-bootstrapper"
DEBIAN = ("PyYAML", "numpy", "lark-parser", "empy", "catkin-pkg", "packaging", "setuptools", "colcon-common-extensions")
"""Python packages on which the Debian packages of ROS depend, and colcon."""
SETUP = """
export AMENT_PREFIX_PATH={prefix} CMAKE_PREFIX_PATH={prefix} PYTHONPATH={prefix}/{modules}
export LD_LIBRARY_PATH={libraries} PATH={prefix}/bin:$PATH
export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
"""


def is_ros(name: str) -> bool:
    return name.startswith("ros-") and name != BOOTSTRAP


def copy(source: Distribution, prefix: Path) -> None:
    """Copy the files of an installed package to the same places below another prefix."""
    for file in source.files or ():
        path, target = Path(str(source.locate_file(file))), prefix / os.path.normpath(MODULES / file)
        if path.is_file() and "__pycache__" not in file.parts:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, target)
            if target.parent.name == "bin":  # its first line names the environment's interpreter
                target.write_bytes(re.sub(rb"\A#!/.*python.*", b"#!/usr/bin/env python3", target.read_bytes()))


def closure(names: tuple[str, ...]) -> dict[str, Distribution]:
    """Return packages and all that they require, without those of ROS."""
    found: dict[str, Distribution] = {}
    pending = list(names)
    while pending:
        requirement = Requirement(pending.pop())
        name = requirement.name.lower().replace("_", "-")
        applies = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        if applies and name not in found and not is_ros(name):
            found[name] = distribution(name)
            pending += found[name].requires or ()
    return found


def install(prefix: Path, *names: str) -> None:
    for found in closure(names).values():
        copy(found, prefix)


def make_underlay(prefix: Path) -> None:
    """Lay out what the wheels of ROS bring, with a setup.bash."""
    for found in distributions():
        if is_ros(found.metadata["Name"]):
            copy(found, prefix)
    libraries = [prefix / "lib", *sorted((prefix / MODULES).glob("ros_*.libs"))]
    described = SETUP.format(prefix=prefix, modules=MODULES, libraries=":".join(map(str, libraries)))
    (prefix / "setup.bash").write_text(described, encoding="utf-8")


if __name__ == "__main__":
    install(Path(sys.argv[1]), *sys.argv[2:])
