"""Checks of the machine that a bundle is for, made on that machine; nothing is changed."""

from __future__ import annotations

import importlib.util
import os
import pwd
import re
import shutil
import socket
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from swarmabs_bringup.doctor import Finding
from swarmabs_bringup.fleet.clock import clock_state

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bringup.fleet.manifest import Manifest

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


def _systemd(manifest: Manifest) -> Finding:
    version = _output("systemctl", "--version")
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
    return _output("systemctl", "is-active", f"swarmabs-{manifest.fleet}.target").strip() == "active"


def _output(*command: str) -> str:
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=5.0, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout


_CHECKS: tuple[Callable[[Manifest], Finding], ...] = (
    _interface,
    _ports,
    _clock,
    _packages,
    _checkout,
    _account,
    _systemd,
)
