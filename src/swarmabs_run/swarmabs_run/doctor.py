"""Checks of the machine: problems that would prevent a run, and how to fix them."""

from __future__ import annotations

import importlib
import os
import platform
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import psutil

from swarmabs_bag.attached import versions
from swarmabs_config.ports import LARGEST_DOMAIN
from swarmabs_config.scenario import load_scenario
from swarmabs_config.scenarios import builtin_scenarios
from swarmabs_core.errors import SwarmabsError
from swarmabs_core.messages import TOPICS
from swarmabs_run.orchestration.network import check_loopback, claimed_domain
from swarmabs_run.processes import usable_cores

try:
    import resource
except ModuleNotFoundError:  # on Windows
    resource = None  # type: ignore[assignment]

if TYPE_CHECKING:
    from collections.abc import Callable

BUFFERS = Path("/proc/sys/net/core")
"""Folder with the kernel's limits on socket buffers."""
_BUFFER = 4 * 2**20
_AGENT_MEMORY = 15 * 2**20
_DESCRIPTORS = 1024


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check: fine, a note, or a problem that prevents runs."""

    check: str
    verdict: Literal["ok", "note", "bad"]
    text: str


Verdict: TypeAlias = tuple[Literal["ok", "note", "bad"], str]
"""Result of a check: the last two fields of its `Finding`."""


def examine() -> list[Finding]:
    """Run all checks; none of them changes anything or leaves anything behind."""
    return [Finding(name, *check()) for name, check in CHECKS.items()]


def _python() -> Verdict:
    return "ok", ", ".join(f"{name} {text}" for name, text in versions().items())


def _ros() -> Verdict:
    try:
        rclpy = importlib.import_module("rclpy.impl.implementation_singleton").rclpy_implementation
        direct = hasattr(rclpy, "WaitSet") and hasattr(rclpy.Subscription, "take_message")
    except ImportError as error:
        return "bad", f"cannot be imported ({error}); run ./scripts/swarm again, or source ROS 2 Jazzy"
    if not direct:
        return "bad", "does not support direct waiting; run ./scripts/swarm again, or source ROS 2 Jazzy"
    return "ok", f"imported; middleware {os.environ.get('RMW_IMPLEMENTATION', 'default')}"


def _messages() -> Verdict:
    try:
        module = importlib.import_module("swarmabs_msgs.msg")
        missing = [topic.ros_type for topic in TOPICS if not hasattr(module, topic.type_name)]
    except ImportError as error:
        return "bad", f"swarmabs_msgs cannot be imported ({error}); build the workspace"
    if missing:
        return "bad", f"swarmabs_msgs is too old: {missing[0]} is missing; build the workspace again"
    return "ok", f"{len({topic.ros_type for topic in TOPICS})} types"


def _loopback() -> Verdict:
    try:
        check_loopback()
    except SwarmabsError as error:
        return "bad", str(error)
    return "ok", "UDP on 127.0.0.1 works"


def _buffers() -> Verdict:
    sizes = {}
    for name in ("rmem_max", "wmem_max"):
        try:
            sizes[name] = int((BUFFERS / name).read_text(encoding="ascii"))
        except (OSError, ValueError):
            continue
    small = [f"net.core.{name}={_BUFFER}" for name, size in sizes.items() if size < _BUFFER]
    if small:
        return "note", f"large swarms start and run faster with: sudo sysctl -w {' '.join(small)}"
    return "ok", "at least 4 MiB"


def _domain() -> Verdict:
    try:
        with claimed_domain() as domain:
            return "ok", f"{domain} is free"
    except SwarmabsError as error:
        return "bad", str(error)


def _memory() -> Verdict:
    free = psutil.virtual_memory().available
    return "ok", f"{free / 2**30:.1f} GiB free, enough for about {free // _AGENT_MEMORY} robots"


def _cores() -> Verdict:
    return "ok", f"{usable_cores()} cores, {platform.machine()}"


def _descriptors() -> Verdict:
    if resource is not None:
        soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
        if soft != resource.RLIM_INFINITY:
            if soft < _DESCRIPTORS:
                return "note", f"limit {soft}; raise it with: ulimit -n {_DESCRIPTORS}"
            return "ok", f"limit {soft}"
    return "ok", "no limit"


def _disk() -> Verdict:
    free = shutil.disk_usage(Path.cwd()).free
    if free < 2**30:
        return "note", f"only {free / 2**20:.0f} MiB free here; a bag needs at least 1 MB"
    return "ok", f"{free / 2**30:.1f} GiB free here"


def _scenarios() -> Verdict:
    try:
        names = [load_scenario(path).name for path in builtin_scenarios().values()]
    except SwarmabsError as error:
        return "bad", f"{error}; build the workspace again"
    if not names:
        return "bad", "the built-in scenarios are missing; build the workspace again"
    return "ok", f"{len(names)} built in"


def _visibility() -> Verdict:
    text = f"a run uses loopback and a separate ROS domain (up to {LARGEST_DOMAIN}); to inspect it: "
    return "note", f'{text}eval "$(./scripts/swarm env RUN)"'


CHECKS: dict[str, Callable[[], Verdict]] = {
    "versions": _python,
    "rclpy": _ros,
    "messages": _messages,
    "scenarios": _scenarios,
    "loopback": _loopback,
    "socket buffers": _buffers,
    "ROS domain": _domain,
    "processor": _cores,
    "memory": _memory,
    "open files": _descriptors,
    "disk": _disk,
    "stock ROS tools": _visibility,
}
"""The checks by name."""
