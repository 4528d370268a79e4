"""Checks that run on the host of a bundle and change nothing."""

from __future__ import annotations

import importlib.util
import os
import pwd
import re
import shutil
import socket
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from swarmabs_fleet.host_plan import PUBLIC_KEYS
from swarmabs_run.doctor import Finding

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from swarmabs_fleet.bundle import Manifest
    from swarmabs_run.doctor import Verdict

_NEEDED_SYSTEMD = 250
"""The first version that supports RestrictNetworkInterfaces."""
_PATIENCE = 5.0
"""Time limit, s, of a program that is queried."""
_CHRONY_FIELDS = 14


def check_host(manifest: Manifest) -> list[Finding]:
    """Check this machine as the host of a bundle."""
    return [Finding(name, *check(manifest)) for name, check in _CHECKS.items()]


def _interface(manifest: Manifest) -> Verdict:
    interfaces = psutil.net_if_addrs()
    if manifest.interface not in interfaces:
        there = ", ".join(sorted(interfaces))
        remedy = " or start wg-quick" if manifest.security == "tunnel" else ""
        return "bad", f"no interface {manifest.interface} on this host ({there}); correct the fleet file{remedy}"
    own = [entry.address for entry in interfaces[manifest.interface] if entry.family == socket.AF_INET]
    if manifest.address not in own:
        addresses = ", ".join(own) or "no IPv4 address"
        text = f"{manifest.interface} has {addresses} instead of {manifest.address}"
        return "bad", f"{text}; correct the host or the fleet file"
    stats = psutil.net_if_stats().get(manifest.interface)
    if stats is not None and not stats.isup:
        return "bad", f"{manifest.interface} is down; run: ip link set {manifest.interface} up"
    return "ok", f"{manifest.interface} has the address {manifest.address}"


def _ports(manifest: Manifest) -> Verdict:
    held = []
    if not any(entry.address == manifest.address for entries in psutil.net_if_addrs().values() for entry in entries):
        return "note", f"not checked: this host does not have the address {manifest.address}"
    for port in manifest.ports:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((manifest.address, port))
            except OSError as error:
                held.append(f"{port} ({error.strerror})")
    if not held:
        return "ok", f"{len(manifest.ports)} UDP ports of domain {manifest.domain} are free"
    if _active(manifest):
        return "note", "in use by the fleet's own nodes, which are running"
    return (
        "bad",
        f"UDP port {held[0]} is not free; find its owner with 'ss -ulnp' and stop it, or choose another domain",
    )


def _clock(manifest: Manifest) -> Verdict:
    state, limit = clock_state(), manifest.max_offset
    if state is None:
        return "bad", "not synchronised by any service; install chrony, and let all hosts follow one server"
    if not state.synchronised:
        return "bad", f"not synchronised according to {state.source}; let all hosts follow one server"
    if state.bound is None:
        return "note", f"synchronised according to {state.source}, which does not report the error; chrony and PTP do"
    if state.bound > limit:
        text = f"may be off by {state.bound:.4f} s according to {state.source}, more than time.max_offset ({limit:g} s)"
        return "bad", f"{text}; let all hosts follow one server in the fleet's network"
    return "ok", f"off by at most {state.bound:.6f} s according to {state.source}"


@dataclass(frozen=True, slots=True)
class ClockState:
    """Whether the clock is synchronised, which program reports it, and the error bound, s, if known."""

    source: str
    synchronised: bool
    bound: float | None = None


def clock_state() -> ClockState | None:
    """Return the state from the first of chrony, linuxptp and systemd that answers, None if none does."""
    for command, read in (
        (("chronyc", "-n", "-c", "tracking"), read_chrony),
        (("pmc", "-u", "-b", "0", "GET TIME_STATUS_NP"), read_pmc),
        (("timedatectl", "show", "--property=NTPSynchronized", "--value"), read_timedatectl),
    ):
        if (text := _answer(*command)) and (state := read(text)):
            return state
    return None


def read_chrony(text: str) -> ClockState | None:
    """Read ``chronyc -c tracking``: the error is at most offset + root dispersion + half the root delay."""
    fields = text.strip().split(",")
    if len(fields) != _CHRONY_FIELDS:
        return None
    try:
        offset, delay, dispersion = (float(fields[index]) for index in (4, 10, 11))
    except ValueError:
        return None
    if fields[13] == "Not synchronised":
        return ClockState("chrony", synchronised=False)
    return ClockState("chrony", synchronised=True, bound=abs(offset) + dispersion + delay / 2.0)


def read_pmc(text: str) -> ClockState | None:
    """Read ptp4l's status: the offset from the master in ns, and whether a master is present."""
    offset = re.search(r"\bmaster_offset\s+(-?\d+)\b", text)
    present = re.search(r"\bgmPresent\s+(\w+)", text)
    if offset is None or present is None:
        return None
    if present[1] != "true":
        return ClockState("PTP", synchronised=False)
    return ClockState("PTP", synchronised=True, bound=abs(int(offset[1])) * 1e-9)


def read_timedatectl(text: str) -> ClockState | None:
    """Read whether systemd considers the clock synchronised; it does not report the error."""
    answer = text.strip()
    return ClockState("systemd", synchronised=answer == "yes") if answer in {"yes", "no"} else None


def _packages(manifest: Manifest) -> Verdict:
    signing = ("cryptography",) if PUBLIC_KEYS in manifest.files else ()
    for module in (*manifest.modules, "rclpy", "swarmabs_msgs", *signing):
        try:
            installed = importlib.util.find_spec(module) is not None
        except ImportError:
            installed = False
        if not installed:
            remedy = "install it" if module in signing else "bring this checkout to the fleet's version"
            return "bad", f"{module} cannot be imported; {remedy}"
    return "ok", f"{len(manifest.modules)} node modules are installed"


def _checkout(manifest: Manifest) -> Verdict:
    program = Path(manifest.checkout) / "scripts" / "swarm"
    if not os.access(program, os.X_OK):
        return "bad", f"{program} does not exist; put the checkout there, or correct the fleet file"
    if manifest.ros == "wheels" and not os.access(_python(manifest), os.X_OK):
        return "bad", f"{manifest.checkout} is not set up; run there: ./scripts/swarm doctor"
    return "ok", manifest.checkout


def _account(manifest: Manifest) -> Verdict:
    user = manifest.user
    try:
        entry = pwd.getpwnam(user)
    except KeyError:
        return "bad", f"account {user} does not exist; create it: useradd --system --shell /usr/sbin/nologin {user}"
    if entry.pw_uid == 0:
        return "bad", f"{user} is root; set another installation.user in the fleet file"
    return "ok", user


def _access(manifest: Manifest) -> Verdict:
    """Check that the account of the nodes can read the installed bundle and run the interpreter of the checkout.

    The check uses owners and modes and ignores access control lists.
    """
    try:
        entry = pwd.getpwnam(manifest.user)
    except KeyError:
        return "note", f"not checked: account {manifest.user} does not exist"
    installed = Path(manifest.installed)
    try:
        installed.stat()
    except PermissionError:
        pass  # a path below a folder that cannot be entered counts as existing
    except OSError:
        return "note", f"not checked: nothing is installed in {installed}"
    try:
        closed = _closed(manifest, Reader.of(entry))
    except PermissionError as error:
        return "note", f"not checked: {error.filename} cannot be entered; run this check as root"
    except OSError as error:
        return "bad", f"{error.filename}: {error.strerror}; run install.sh of the bundle again"
    if closed is None:
        return "ok", f"{manifest.user} can read {installed}"
    ours = closed.is_relative_to(installed.parent)
    remedy = "run install.sh of the bundle again" if ours else "grant it access, for example with chmod o+rx"
    mode = closed.stat().st_mode & 0o7777
    return "bad", f"{manifest.user} has no access to {closed} (mode {mode:04o}), so no node starts; {remedy}"


def _closed(manifest: Manifest, reader: Reader) -> Path | None:
    """Return the first folder or file that a node needs but its account cannot use.

    Raises
    ------
    OSError
        If one of them does not exist or cannot be examined.
    """
    for path in manifest.files:
        # Only root reads the configuration of a tunnel.
        if not path.startswith("wireguard/") and (closed := reader.stopped_at(Path(manifest.installed) / path)):
            return closed
    if manifest.ros != "wheels":
        return None
    python = _python(manifest)
    return reader.stopped_at(python) or (None if reader.may(python, os.X_OK) else python)


@dataclass(frozen=True, slots=True)
class Reader:
    """The user and groups of an account, for checks of file modes."""

    uid: int
    groups: frozenset[int]

    @classmethod
    def of(cls, entry: pwd.struct_passwd) -> Reader:
        """Return the account of a password database entry."""
        return cls(entry.pw_uid, frozenset(os.getgrouplist(entry.pw_name, entry.pw_gid)))

    def may(self, path: Path, wanted: int) -> bool:
        """Return whether the account has the permission `os.R_OK` or `os.X_OK` for a file or folder."""
        status = path.stat()
        if self.uid == 0:
            return True
        shift = 6 if status.st_uid == self.uid else 3 if status.st_gid in self.groups else 0
        return bool(status.st_mode >> shift & wanted)

    def stopped_at(self, path: Path) -> Path | None:
        """Return the first parent that the account cannot enter, or the file itself if the account cannot read it."""
        for folder in reversed(path.parents):
            if not self.may(folder, os.X_OK):
                return folder
        return None if self.may(path, os.R_OK) else path


def _python(manifest: Manifest) -> Path:
    return Path(manifest.checkout) / ".venv" / "bin" / "python"


def _systemd(manifest: Manifest) -> Verdict:
    version = re.match(r"systemd (\d+)", _answer("systemctl", "--version"))
    if version is None:
        return "bad", "not installed; bundles need hosts with systemd"
    if int(version[1]) < _NEEDED_SYSTEMD:
        text = f"version {version[1]} cannot restrict nodes to one interface; {_NEEDED_SYSTEMD} and later can"
        return "note", f"{text}; see docs/how-to/security.md for other protection"
    running = "; the fleet's nodes are running" if _active(manifest) else ""
    return "ok", f"version {version[1]}{running}"


def _active(manifest: Manifest) -> bool:
    return _answer("systemctl", "is-active", f"swarmabs-{manifest.fleet}.target").strip() == "active"


def _answer(*command: str) -> str:
    """Return the output of a program, empty if it is missing or fails."""
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_PATIENCE, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""


_CHECKS: Mapping[str, Callable[[Manifest], Verdict]] = {
    "interface": _interface,
    "ports": _ports,
    "clock": _clock,
    "packages": _packages,
    "checkout": _checkout,
    "account": _account,
    "access": _access,
    "systemd": _systemd,
}
