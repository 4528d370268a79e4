"""Test hosts with what a robot's computer has: a disk that outlives power cuts, services, a checkout."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.hosts.cluster import Host, finish, until_ready
from tests.processes import ROOT, until

ACCOUNT = "swarmabs"
_MANAGER = "tests.hosts.service_manager"
_KEPT = ("group", "hosts", "ld.so.cache", "ld.so.conf", "ld.so.conf.d", "nsswitch.conf", "alternatives", "os-release")
"""Of this machine's /etc; nothing that is secret."""
_OWN = ("HOME", "TMPDIR", "ROS_LOG_DIR")
"""Variables that name folders of a host's own."""
_BOOT_WITHIN = 60.0


class Checkout:
    """What stands for a prepared checkout: `scripts/swarm` and `.venv/bin/python` that start these sources.

    Further Python packages may be in a `search_path`, and libraries that are preferred to those of ROS in a folder.
    With such libraries it also stands for an installed ROS: `setup` is its setup script, `python` its interpreter.
    """

    def __init__(self, folder: Path, search_path: str = "", libraries: Path | None = None) -> None:
        own = os.pathsep.join(filter(None, [str(ROOT), search_path, os.environ.get("PYTHONPATH")]))
        self.folder, self.programs = folder / "checkout", folder / "programs"
        self.swarm = self.folder / "scripts" / "swarm"
        self.setup, self.sourced = folder / "setup.sh", libraries is not None
        self.python = self.folder / ".venv" / "bin" / "python"
        environment = {**os.environ, "PYTHONPATH": own, "PATH": f"{self.programs}:{os.environ['PATH']}"}
        if libraries is not None:
            environment |= preferring(libraries)
        lines = [f"export {name}={shlex.quote(value)}" for name, value in sorted(environment.items()) if name != "_"]
        python = shlex.quote(sys.executable)
        _program(self.setup)
        _program(self.python, f'exec {python} "$@"')
        _program(self.swarm, *lines, f'exec {python} -m swarmabs_cli "$@"')
        _program(self.programs / "systemctl", *lines, f'exec {python} -m {_MANAGER} systemctl "$@"')


def preferring(libraries: Path) -> dict[str, str]:
    """Return the variable with which a process finds its libraries in a folder first."""
    return {"LD_LIBRARY_PATH": os.pathsep.join(filter(None, [str(libraries), os.environ.get("LD_LIBRARY_PATH")]))}


def _program(path: Path, *lines: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(["#!/bin/sh", *lines, ""]), encoding="utf-8")
    path.chmod(0o755)


class Station:
    """A host with a disk. Its services are those that are enabled in its own /etc."""

    def __init__(self, host: Host, name: str, folder: Path, checkout: Checkout) -> None:
        self.host, self.name = host, name
        self.etc, self.state = folder / name / "etc", folder / name / "lib"
        self._checkout = checkout
        (self.etc / "systemd" / "system").mkdir(parents=True)
        self.state.mkdir()
        for kept in _KEPT:
            here = Path("/etc") / kept
            if here.is_dir():
                shutil.copytree(here, self.etc / kept, symlinks=True)
            elif here.is_file():
                shutil.copyfile(here, self.etc / kept)
        users = [line for line in Path("/etc/passwd").read_text().splitlines() if line.startswith(("root:", "nobody:"))]
        users.append(f"{ACCOUNT}:x:990:990::/nonexistent:/usr/sbin/nologin")
        (self.etc / "passwd").write_text("".join(f"{line}\n" for line in users))
        if host.alive:
            self.power_on()

    def power_on(self) -> None:
        """Switch it on: its services start, without waiting for them."""
        if not self.host.alive:
            self.host.revive()
        for own, place in ((self.etc, "/etc"), (self.state, "/var/lib")):
            self.host.run(["mount", "--bind", own, place])
        if self._checkout.sourced:
            self.host.run(["mount", "--bind", self._checkout.python, "/usr/bin/python3"])
        until_ready(self.host.python(_MANAGER, stdout=subprocess.PIPE))

    def run(self, *words: object, **options: Any) -> str:
        return finish(self.start(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options))

    def start(self, *words: object, **options: Any) -> subprocess.Popen[Any]:
        """Start a program as root, with the host's own commands."""
        own = {"PATH": f"{self._checkout.programs}:{os.environ['PATH']}"} | dict.fromkeys(_OWN, "/run")
        return self.host.start(words, env=own, **options)

    def swarm(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Run the command line of swarmabs; return what became of it."""
        process = self.start(self._checkout.swarm, *words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        out, err = process.communicate(timeout=_BOOT_WITHIN)
        return subprocess.CompletedProcess(words, process.returncode, out, err)

    def until_active(self, unit: str) -> None:
        """Wait until a service, or all of a target, is active."""
        asking = ("systemctl", "is-active", "--quiet", unit)
        until(
            lambda: self.start(*asking).wait() == 0,
            lambda: f"{unit} is active; {self.log()}",
            _BOOT_WITHIN,
        )

    def log(self) -> str:
        return "\n".join(f"{path.name}:\n{path.read_text()}" for path in sorted((self.etc / "log").glob("*.log")))
