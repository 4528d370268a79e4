"""Checks of the machine that a bundle is for, made on that machine; nothing is changed."""

from __future__ import annotations

import importlib.util
import os
import pwd
import re
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from swarmabs_fleet.clock import answer, clock_state
from swarmabs_run.doctor import Finding

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_fleet.manifest import Manifest

_NEEDED_SYSTEMD = 250
"""The first version that knows RestrictNetworkInterfaces."""


def check_host(manifest: Manifest) -> list[Finding]:
    """Examine this machine as the host of a bundle."""
    return [check(manifest) for check in _CHECKS]


def _interface(manifest: Manifest) -> Finding:
    what = "interface"
    interfaces = psutil.net_if_addrs()
    if manifest.interface not in interfaces:
        there = ", ".join(sorted(interfaces))
        start = "; start wg-quick" if manifest.security == "tunnel" else ""
        return Finding(what, "bad", f"there is no {manifest.interface} here ({there}); correct the fleet file{start}")
    own = [entry.address for entry in interfaces[manifest.interface] if entry.family == socket.AF_INET]
    if manifest.address not in own:
        found = ", ".join(own) or "none"
        return Finding(
            what, "bad", f"{manifest.interface} has not the address {manifest.address} but {found}; correct one of them"
        )
    stats = psutil.net_if_stats().get(manifest.interface)
    if stats is not None and not stats.isup:
        return Finding(what, "bad", f"{manifest.interface} is down; ip link set {manifest.interface} up")
    return Finding(what, "ok", f"{manifest.interface} has the address {manifest.address}")


def _ports(manifest: Manifest) -> Finding:
    held = []
    if not any(entry.address == manifest.address for found in psutil.net_if_addrs().values() for entry in found):
        return Finding("ports", "note", f"not tried: {manifest.address} is not here")
    for port in manifest.ports:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((manifest.address, port))
            except OSError as error:
                held.append(f"{port} ({error.strerror})")
    if not held:
        return Finding("ports", "ok", f"{len(manifest.ports)} UDP ports of domain {manifest.domain} are free")
    if _active(manifest):
        return Finding("ports", "note", "the fleet's own nodes are running and hold them")
    return Finding(
        "ports", "bad", f"UDP {held[0]} cannot be had; see 'ss -ulnp', end what holds it or choose another domain"
    )


def _clock(manifest: Manifest) -> Finding:
    what, state = "clock", clock_state()
    if state is None:
        return Finding(what, "bad", "nothing synchronises it; install chrony, and let all hosts follow one server")
    if not state.synchronised:
        return Finding(what, "bad", f"it is not synchronised, {state.source} says; let all hosts follow one server")
    if state.bound is None:
        return Finding(
            what, "note", f"it is synchronised, {state.source} says, but not how well; chrony or PTP would say"
        )
    limit = manifest.max_offset
    if state.bound > limit:
        return Finding(
            what,
            "bad",
            f"it may be off by {state.bound:.4f} s by {state.source}, more than time.max_offset {limit:g} s; "
            "let all hosts follow one server in the fleet's network",
        )
    return Finding(what, "ok", f"it is off by at most {state.bound:.6f} s by {state.source}")


def _packages(manifest: Manifest) -> Finding:
    missing = []
    for module in (*manifest.modules, "rclpy", "swarmabs_msgs"):
        try:
            found = importlib.util.find_spec(module) is not None
        except ImportError:
            found = False
        if not found:
            missing.append(module)
    if missing:
        return Finding(
            "packages", "bad", f"{missing[0]} cannot be imported; bring this checkout to the fleet's version"
        )
    return Finding("packages", "ok", f"{len(manifest.modules)} modules of nodes are there")


def _checkout(manifest: Manifest) -> Finding:
    program = Path(manifest.checkout) / "scripts" / "swarm"
    if not os.access(program, os.X_OK):
        return Finding("checkout", "bad", f"there is no {program}; put the checkout there, or correct the fleet file")
    python = Path(manifest.checkout) / ".venv" / "bin" / "python"
    if manifest.ros == "wheels" and not os.access(python, os.X_OK):
        return Finding("checkout", "bad", f"{manifest.checkout} is not prepared; start there: ./scripts/swarm doctor")
    return Finding("checkout", "ok", manifest.checkout)


def _account(manifest: Manifest) -> Finding:
    try:
        entry = pwd.getpwnam(manifest.user)
    except KeyError:
        return Finding(
            "account",
            "bad",
            f"there is no {manifest.user}; make it: useradd --system --shell /usr/sbin/nologin {manifest.user}",
        )
    if entry.pw_uid == 0:
        return Finding("account", "bad", f"{manifest.user} is root; name another installation.user in the fleet file")
    return Finding("account", "ok", manifest.user)


def _readable(manifest: Manifest) -> Finding:
    """Say whether the account of the nodes can read its installed bundle and start the checkout's interpreter.

    What decides are owners and modes; access control lists are not looked at.
    """
    what = "access"
    try:
        entry = pwd.getpwnam(manifest.user)
    except KeyError:
        return Finding(what, "note", f"not looked at: there is no account {manifest.user}")
    installed = Path(manifest.installed)
    if not _is_there(installed):
        return Finding(what, "note", f"not looked at: nothing is installed in {installed}")
    try:
        closed = _closed(manifest, Reader.of(entry))
    except PermissionError as error:
        return Finding(what, "note", f"not looked at: {error.filename} cannot be entered; start this as root")
    except OSError as error:
        return Finding(what, "bad", f"{error.filename}: {error.strerror}; start install.sh of the bundle again")
    if closed is None:
        return Finding(what, "ok", f"{manifest.user} can read {installed}")
    ours = closed.is_relative_to(installed.parent)
    remedy = "start install.sh of the bundle again" if ours else "let others enter it"
    mode = closed.stat().st_mode & 0o7777
    return Finding(
        what, "bad", f"{manifest.user} has no access to {closed} (mode {mode:04o}), so no node starts; {remedy}"
    )


def _closed(manifest: Manifest, reader: Reader) -> Path | None:
    """Return the first of the folders and files that a node needs which its account cannot use.

    Raises
    ------
    OSError
        If one of them is not there, or cannot be looked at.
    """
    for path in manifest.files:
        # Of a tunnel's configuration only root needs to know.
        if not path.startswith("wireguard/") and (closed := reader.stopped_at(Path(manifest.installed) / path)):
            return closed
    if manifest.ros != "wheels":
        return None
    python = Path(manifest.checkout) / ".venv" / "bin" / "python"
    return reader.stopped_at(python) or (None if reader.may(python, os.X_OK) else python)


def _is_there(path: Path) -> bool:
    """Say whether something is at a path; what is behind a closed folder counts as there."""
    try:
        path.stat()
    except PermissionError:
        return True
    except OSError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class Reader:
    """An account, as far as the modes of files are concerned."""

    uid: int
    groups: frozenset[int]

    @classmethod
    def of(cls, entry: pwd.struct_passwd) -> Reader:
        """Return the account of an entry in the list of accounts."""
        return cls(entry.pw_uid, frozenset(os.getgrouplist(entry.pw_name, entry.pw_gid)))

    def may(self, path: Path, wanted: int) -> bool:
        """Say whether the account has a right to a file or folder, `os.R_OK` or `os.X_OK`."""
        found = path.stat()
        if self.uid == 0:
            return True
        shift = 6 if found.st_uid == self.uid else 3 if found.st_gid in self.groups else 0
        return bool(found.st_mode >> shift & wanted)

    def stopped_at(self, path: Path) -> Path | None:
        """Return the first folder on the way that the account cannot enter, or the file that it cannot read."""
        for folder in reversed(path.parents):
            if not self.may(folder, os.X_OK):
                return folder
        return None if self.may(path, os.R_OK) else path


def _systemd(manifest: Manifest) -> Finding:
    version = answer("systemctl", "--version")
    found = re.match(r"systemd (\d+)", version)
    if found is None:
        return Finding("systemd", "bad", "there is none; bundles are for hosts with systemd")
    if int(found[1]) < _NEEDED_SYSTEMD:
        return Finding(
            "systemd",
            "note",
            f"version {found[1]} cannot lock nodes in one interface, {_NEEDED_SYSTEMD} can; "
            "what else protects the network: docs/security.md",
        )
    running = "; the fleet's nodes are running" if _active(manifest) else ""
    return Finding("systemd", "ok", f"version {found[1]}{running}")


def _active(manifest: Manifest) -> bool:
    return answer("systemctl", "is-active", f"swarmabs-{manifest.fleet}.target").strip() == "active"


_CHECKS: tuple[Callable[[Manifest], Finding], ...] = (
    _interface,
    _ports,
    _clock,
    _packages,
    _checkout,
    _account,
    _readable,
    _systemd,
)
