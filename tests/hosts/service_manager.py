"""What a test host has instead of systemd: it keeps the services of unit files running, and obeys `systemctl`.

It knows what the units of a bundle use: Type=notify with start timeout and watchdog, ExecStartPre, environment files,
StateDirectory, Restart=on-failure with its exception. All targets that are there are enabled. It does not lock services
in, and all of them run as root.

Usage: python -m tests.hosts.service_manager                    (serves, and starts what is enabled)
       python -m tests.hosts.service_manager systemctl WORDS... (asks the one that serves)
"""

import json
import os
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from tests.hosts.namespaces import say
from tests.processes import MARK

UNITS = Path("/etc/systemd/system")
STATES = Path("/var/lib")
LOGS = Path("/etc/log")
"""Beside the units, so that logs outlive the host."""
_SOCKET = "/run/service_manager"


def settings_of(unit: Path) -> dict[str, list[str]]:
    """Return the values of a unit's settings; some occur more than once."""
    found: dict[str, list[str]] = {}
    for line in unit.read_text(encoding="utf-8").splitlines():
        name, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found.setdefault(name, []).append(value)
    return found


class Service:
    """One service, kept running by a thread while it is wanted."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._settings = settings_of(UNITS / name)
        self._unwanted, self._settled = threading.Event(), threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._keep, daemon=True)
        self.active = False
        self._thread.start()

    def settled(self) -> bool:
        """Wait until the service is active or has failed; return whether it is active."""
        self._settled.wait(self._seconds("TimeoutStartSec"))
        return self.active

    @property
    def kept(self) -> bool:
        """Whether it is running, or will be again."""
        return self._thread.is_alive()

    def signal(self, number: int) -> None:
        """Tell what runs to end, or kill it, as a crash does."""
        if self._process is not None:
            self._process.send_signal(number)

    def stop(self) -> None:
        """End the service."""
        self._unwanted.set()
        self.signal(signal.SIGTERM)
        self._thread.join(self._seconds("TimeoutStopSec"))
        self.signal(signal.SIGKILL)
        self._thread.join()

    def _seconds(self, name: str) -> float:
        return float(self._settings[name][-1])

    def _keep(self) -> None:
        assert self._settings["Restart"] == ["on-failure"] and self._settings["Type"] == ["notify"]
        last = {0, -signal.SIGTERM, *map(int, self._settings["RestartPreventExitStatus"])}
        code = None
        while not self._unwanted.is_set() and code not in last:
            with (LOGS / f"{self._name}.log").open("ab", buffering=0) as log:
                code = self._run(log)
                log.write(f"ended with {code}\n".encode())
            self.active = False
            self._settled.set()
            if code not in last:
                self._unwanted.wait(self._seconds("RestartSec"))

    def _run(self, log: object) -> int:
        """Run the service once; return its exit code."""
        environment = {name: os.environ[name] for name in ("PATH", MARK) if name in os.environ}
        environment |= {"HOME": "/run", "TMPDIR": "/run", "LANG": "C.UTF-8"}
        for file in self._settings["EnvironmentFile"]:
            lines = shlex.split(Path(file).read_text(encoding="utf-8"))
            environment |= dict(line.split("=", 1) for line in lines)
        for folder in self._settings.get("StateDirectory", []):
            (STATES / folder).mkdir(mode=0o750, exist_ok=True)
        for command in self._settings.get("ExecStartPre", []):
            done = subprocess.run(shlex.split(command), env=environment, stdout=log, stderr=log, check=False)  # type: ignore[call-overload]
            if done.returncode:
                return int(done.returncode)
        path = f"/run/notify-{self._name}"
        Path(path).unlink(missing_ok=True)
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.bind(path)
            channel.settimeout(0.5)
            watchdog = self._seconds("WatchdogSec")
            environment |= {"NOTIFY_SOCKET": path, "WATCHDOG_USEC": f"{watchdog * 1e6:.0f}"}
            (command,) = self._settings["ExecStart"]
            self._process = process = subprocess.Popen(  # type: ignore[call-overload]
                shlex.split(command), env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd="/"
            )
            heard, patience = time.monotonic(), self._seconds("TimeoutStartSec")
            while process.poll() is None:
                try:
                    said = set(channel.recv(4096).split(b"\n"))
                except TimeoutError:
                    said = set()
                if b"STOPPING=1" in said:
                    patience = self._seconds("TimeoutStopSec")  # no watchdog any more, as with systemd
                elif b"READY=1" in said:
                    self.active, patience = True, watchdog
                    self._settled.set()
                if said & {b"READY=1", b"WATCHDOG=1"}:
                    heard = time.monotonic()
                if time.monotonic() - heard > patience:
                    process.send_signal(signal.SIGABRT)
                    process.send_signal(signal.SIGCONT)  # as systemd does: a stopped process ends, too
                    process.wait()
            return int(process.returncode)


class Manager:
    """All services of a host."""

    def __init__(self) -> None:
        self._services: dict[str, Service] = {}
        for target in sorted(UNITS.glob("*.target")):
            self._launch(_parts(target.name))

    def obey(self, words: list[str]) -> tuple[int, str]:
        """Do what a command line of `systemctl` says; return its exit code and what it prints."""
        verb, *units = [word for word in words if not word.startswith("-")]
        names = [name for unit in units for name in _parts(unit)]
        known = {name: self._services[name] for name in names if name in self._services}
        if verb == "is-active":
            active = bool(names) and len(known) == len(names) and all(each.active for each in known.values())
            return (0, "active") if active else (3, "inactive")
        if verb == "kill":
            for service in known.values():
                service.signal(signal.SIGKILL)
        if verb in {"stop", "restart"}:
            for service in known.values():
                service.stop()
        if verb in {"start", "restart"}:
            self._launch(names)
            settled = [self._services[name].settled() for name in names]
            return (0, "") if all(settled) else (1, "a service has failed")
        return (0, "") if verb in {"kill", "stop", "enable", "daemon-reload"} else (1, f"no such verb: {verb}")

    def _launch(self, names: list[str]) -> None:
        for name in names:
            if name not in self._services or not self._services[name].kept:
                self._services[name] = Service(name)


def _parts(unit: str) -> list[str]:
    """Return the services of a unit: a target's, or itself."""
    path = UNITS / unit
    if not path.is_file():
        return []
    return settings_of(path)["Wants"][0].split() if unit.endswith(".target") else [unit]


def serve() -> None:
    """Keep services until the host ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is for whoever has made the hosts
    LOGS.mkdir(exist_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as door:
        door.bind(_SOCKET)
        door.listen()
        manager = Manager()
        say("ready")
        while True:
            visitor, _ = door.accept()
            with visitor, visitor.makefile("rw") as stream:
                stream.write(json.dumps(manager.obey(json.loads(stream.readline()))) + "\n")


def ask(words: list[str]) -> int:
    """Be `systemctl`."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as door:
        door.connect(_SOCKET)
        with door.makefile("rw") as stream:
            stream.write(json.dumps(words) + "\n")
            stream.flush()
            code, text = json.loads(stream.readline())
    if text and "--quiet" not in words:
        say(text)
    return int(code)


if __name__ == "__main__":
    sys.exit(ask(sys.argv[2:]) if sys.argv[1:2] == ["systemctl"] else serve())
