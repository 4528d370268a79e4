"""Other machines than this interpreter with its C library; docs/developers/testing.md says how to make each."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import pytest

SERIES = ("3.10", "3.11", "3.12", "3.13", "3.14")
"""The versions of CPython that the wheel is for."""
KEPT = ("PATH", "HOME", "LANG", "TMPDIR", "PIP_INDEX_URL", "PIP_CONFIG_FILE", "PIP_CERT", "SSL_CERT_FILE")


class Machine(NamedTuple):
    """Something that runs Python: the words before a program, and environment variables."""

    words: Sequence[str]
    variables: Mapping[str, str] = MappingProxyType({})

    def run(self, *program: object, folder: Path, search: Sequence[Path] = ()) -> str:
        """Run a program with its arguments in a folder; return what it prints."""
        environment = variables() | {**self.variables, "PYTHONPATH": os.pathsep.join(map(str, search))}
        done = subprocess.run(
            [*self.words, *map(str, program)], env=environment, cwd=folder, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


HERE = Machine([sys.executable])


def variables() -> dict[str, str]:
    """Return the environment without ROS and this workspace."""
    return {name: os.environ[name] for name in KEPT if name in os.environ} | {"PYTHONDONTWRITEBYTECODE": "1"}


def interpreter(series: str) -> str:
    """Return the path of an interpreter of this machine; skip the test if there is none."""
    candidates = [sys.executable] if series == "{}.{}".format(*sys.version_info) else []
    candidates += filter(None, [shutil.which(f"python{series}")])
    for folder in (Path.home() / ".pyenv/versions", Path(os.environ.get("RUNNER_TOOL_CACHE", os.devnull), "Python")):
        candidates += map(str, sorted(folder.glob(f"{series}.*/**/bin/python")))
    for path in candidates:
        asked = [path, "-c", "import ensurepip, sys; print('{}.{}'.format(*sys.version_info))"]
        if subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip() == series:
            return path
    pytest.skip(f"no CPython {series} with ensurepip on this machine")


def rig(variable: str, what: str) -> Path:
    """Return the path that an environment variable gives; skip the test if it gives none."""
    if not os.environ.get(variable):
        pytest.skip(f"{variable} does not name {what}")
    return Path(os.environ[variable]).resolve(strict=True)


def executable(name: str) -> str:
    """Return the path of a program; skip the test if there is none."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"there is no {name}")
    return path


def aarch64() -> Machine:
    """Return the interpreter of a folder with the files of a distribution for aarch64, emulated."""
    root = rig("SWARMABS_AARCH64_ROOT", "a folder with Python for aarch64")
    (python,) = root.glob("usr/bin/python3.[0-9]*[0-9]")
    return Machine([executable("qemu-aarch64-static"), "-L", str(root), str(python)])


def other_library() -> Machine:
    """Return this interpreter with another mathematical library."""
    library = rig("SWARMABS_LIBM", "a library with functions of libm")
    return Machine(HERE.words, {"LD_PRELOAD": str(library)})


def webassembly() -> Machine:
    """Return the interpreter that is compiled to WebAssembly."""
    folder = rig("SWARMABS_PYODIDE", "the folder of the npm package pyodide")
    return Machine([executable("node"), str(Path(__file__).with_name("pyodide.mjs")), str(folder)])


MACHINES: dict[str, Callable[[], Machine]] = {
    "aarch64": aarch64,
    "other library": other_library,
    "WebAssembly": webassembly,
    **{f"CPython {series}": lambda series=series: Machine([interpreter(series)]) for series in SERIES},  # type: ignore[misc]
}
