"""Checks of this machine: platform, Python interpreters, compilers."""

from __future__ import annotations

import glob
import json
import os
import platform
import shutil
import subprocess
import sys
from typing import Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Tuple

from _setup.report import UNSUITABLE, SetupError

PREFERRED = ("3.12", "3.13", "3.11", "3.10")
OLDEST_GLIBC = (2, 28)
INSTALL_FOLDERS = (
    "~/.pyenv/versions/{version}.*/bin",
    "~/.local/share/uv/python/cpython-{version}.*/bin",
    "~/.local/bin",
    "/usr/local/bin",
    "/usr/bin",
    "/opt/python*/bin",
    "/opt/python/{version}*/bin",
)
# Runs in the candidate interpreter. A broken shim or an incomplete Python installation fails here.
PROBE = """
import json, os, sys, sysconfig
missing = []
for name in ("venv", "ensurepip"):
    try:
        __import__(name)
    except ImportError:
        missing.append(name)
if not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
    missing.append("Python.h")
if sysconfig.get_config_var("Py_GIL_DISABLED"):
    missing.append("the GIL")
print(json.dumps({
    "path": getattr(sys, "_base_executable", None) or sys.executable,
    "version": "%d.%d.%d" % sys.version_info[:3],
    "implementation": sys.implementation.name,
    "missing": missing,
}))
"""
DEBIAN_SUFFIX = {"venv": "venv", "ensurepip": "venv", "Python.h": "dev"}
# (commands of which one is needed, Debian package that provides it)
BUILD_TOOLS = (
    (("{CC}", "cc", "gcc"), "gcc"),
    (("{CXX}", "c++", "g++"), "g++"),
    (("make",), "make"),
    (("cmake",), "cmake"),
)


class Interpreter(NamedTuple):
    """A Python found on this machine."""

    path: str
    version: str
    implementation: str
    missing: Tuple[str, ...]

    @property
    def series(self) -> str:
        """The language version, such as 3.12."""
        return self.version.rsplit(".", 1)[0]

    def fits(self) -> bool:
        """Whether the locked wheels support it and it can create a venv."""
        return self.implementation == "cpython" and self.series in PREFERRED and not self.missing


def check_platform() -> None:
    """Reject machines without ROS wheels."""
    system, machine = platform.system(), platform.machine()
    if (system, machine) != ("Linux", "x86_64"):
        raise SetupError(
            f"the ROS wheels exist only for x86-64 Linux, not for {machine} {system}; "
            "source a ROS 2 Jazzy installation and set SWARMABS_USE_SOURCED_ROS=1",
            UNSUITABLE,
        )
    libc, version = platform.libc_ver(sys.executable)
    if libc != "glibc" or tuple(int(part) for part in version.split(".")[:2]) < OLDEST_GLIBC:
        wanted = ".".join(map(str, OLDEST_GLIBC))
        raise SetupError(f"the ROS wheels need glibc {wanted} or later, found {libc} {version}", UNSUITABLE)


def try_interpreter(command: str) -> Optional[Interpreter]:
    """Run the probe in an interpreter; None if it does not run."""
    probe = [command, "-I", "-S", "-c", PROBE]
    try:
        answer = subprocess.run(probe, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=20, check=True)
        facts = json.loads(answer.stdout)
    except (OSError, subprocess.SubprocessError, ValueError):
        return None
    return Interpreter(facts["path"], facts["version"], facts["implementation"], tuple(facts["missing"]))


def candidates(series: str, environ: Mapping[str, str]) -> Iterator[str]:
    """Commands that may be a Python of this series: those on PATH, then those in the usual folders."""
    folders = environ.get("PATH", os.defpath).split(os.pathsep)
    if environ.get("PYENV_ROOT"):
        folders += sorted(glob.glob(os.path.join(environ["PYENV_ROOT"], "versions", f"{series}.*", "bin")))
    for pattern in INSTALL_FOLDERS:
        folders += sorted(glob.glob(os.path.expanduser(pattern.format(version=series))), reverse=True)
    for folder in dict.fromkeys(folders):
        command = os.path.join(folder, f"python{series}")
        if folder and os.access(command, os.X_OK) and os.path.isfile(command):
            yield command


def choose_interpreter(environ: Mapping[str, str]) -> Interpreter:
    """Find the best usable Python, or SWARMABS_PYTHON if that is set.

    Raises
    ------
    SetupError
        If none is usable; the message names what is missing and the Debian package that provides it.
    """
    wanted = environ.get("SWARMABS_PYTHON")
    if wanted:
        found = try_interpreter(wanted)
        if found is None:
            raise SetupError(
                f"SWARMABS_PYTHON={wanted} does not start as Python; set it to an interpreter or unset it", UNSUITABLE
            )
        if not found.fits():
            raise SetupError(f"SWARMABS_PYTHON={wanted}: {unfit_reason(found)}", UNSUITABLE)
        return found
    unfit: List[Interpreter] = []
    for series in PREFERRED:
        for command in candidates(series, environ):
            found = try_interpreter(command)
            if found and found.fits():
                return found
            if found:
                unfit.append(found)
    if unfit:
        raise SetupError(unfit_reason(unfit[0]), UNSUITABLE)
    raise SetupError(
        "no CPython 3.10 to 3.13 found; run sudo apt-get install python3 python3-venv python3-dev, "
        "or set SWARMABS_PYTHON",
        UNSUITABLE,
    )


def unfit_reason(found: Interpreter) -> str:
    """Explain why an interpreter cannot be used, with the remedy if there is one."""
    name = f"{found.implementation} {found.version} ({found.path})"
    if found.implementation != "cpython" or found.series not in PREFERRED:
        return f"{name} is not supported; CPython 3.10 to 3.13 is needed"
    reason = f"{name} lacks {' and '.join(found.missing)}"
    suffixes = dict.fromkeys(DEBIAN_SUFFIX[part] for part in found.missing if part in DEBIAN_SUFFIX)
    if found.path.startswith("/usr/bin/") and suffixes:
        packages = " ".join(f"python{found.series}-{suffix}" for suffix in suffixes)
        return f"{reason}: sudo apt-get install {packages}"
    return f"{reason}; set SWARMABS_PYTHON to another interpreter"


def check_build_tools(environ: Mapping[str, str]) -> None:
    """Raise `SetupError` if a compiler or build tool is missing; the message names its Debian package."""
    packages = list(missing_packages(environ))
    if packages:
        names = " ".join(packages)
        raise SetupError(
            f"building the message package needs {', '.join(packages)}: sudo apt-get install {names}",
            UNSUITABLE,
        )


def check_colcon(environ: Mapping[str, str]) -> None:
    """Raise `SetupError` if colcon, which ROS does not include, is missing."""
    if not shutil.which("colcon", path=environ.get("PATH")):
        raise SetupError("colcon is missing: sudo apt-get install python3-colcon-common-extensions", UNSUITABLE)


def missing_packages(environ: Mapping[str, str]) -> Iterable[str]:
    """Debian packages of the build tools that are not on PATH."""
    chosen: Dict[str, str] = {name: environ.get(name) or "-" for name in ("CC", "CXX")}
    for commands, package in BUILD_TOOLS:
        names = (command.format(**chosen).split()[0] for command in commands)
        if not any(shutil.which(name, path=environ.get("PATH")) for name in names):
            yield package
