"""Shared by the baseline programs: the messages as bytes, the worker processes, and their measurement.

A baseline program exchanges the messages of a run between as many processes as a run has, without mathematics, checks
or recording. It shares no code with the product. Its main process imports all modules, forks one process per role,
waits until all are connected, and starts them. It then answers every line on standard input with a line of JSON on
standard output that contains the current step. When standard input closes, it kills and reaps its processes and exits.
No process or file remains, however it ends.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import mmap
import os
import select
import signal
import struct
import sys
import time
import traceback
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    Role = Callable[["Workers"], None]

_HEAD = struct.Struct("<4siII6s6xQ")  # encapsulation | stamp | frame id | step
_PAYLOADS = {"agent": "QHBB4x5d", "plane": "2d", "abstract": "H6x4d", "auxiliary": "8d", "desired": "B7x8d"}
_STEP = struct.Struct("<Q")
_STEP_AT = _HEAD.size - _STEP.size
_AGENT_AT = _HEAD.size + 8
_COUNTER = struct.Struct("Q")
_PR_SET_PDEATHSIG, _PR_SET_NAME = 1, 15
_START_SECONDS = 120.0
SHORTEST_PATIENCE, LONGEST_PATIENCE = 0.05, 1.0

SIZES = {name: _HEAD.size + struct.calcsize("<" + payload) for name, payload in _PAYLOADS.items()}
"""Size of every message, bytes, as in the product."""


def blank(name: str, agent: int = 0) -> bytearray:
    """Return a message that is all zeros except for the robot's id."""
    message = bytearray(SIZES[name])
    _HEAD.pack_into(message, 0, b"\x00\x01\x00\x00", 0, 0, 6, b"plane\x00", 0)
    if agent:
        struct.pack_into("<H", message, _AGENT_AT, agent)
    return message


def stamped(message: bytearray, step: int) -> bytes:
    """Set the step of a message and return the bytes to send."""
    _STEP.pack_into(message, _STEP_AT, step)
    return bytes(message)


def step_of(data: bytes) -> int:
    """Return the step of a message."""
    step: int = _STEP.unpack_from(data, _STEP_AT)[0]
    return step


def agent_of(data: bytes) -> int:
    """Return the id of the robot that sent a message."""
    return data[_AGENT_AT] | data[_AGENT_AT + 1] << 8


class Patience:
    """The time to wait before resending: several step times, since resending too early causes a message storm."""

    def __init__(self) -> None:
        self._last = time.monotonic()
        self.seconds = LONGEST_PATIENCE

    def step(self) -> None:
        """Update the patience after a step."""
        now = time.monotonic()
        self.seconds = min(LONGEST_PATIENCE, max(SHORTEST_PATIENCE, 4.0 * (now - self._last), 0.9 * self.seconds))
        self._last = now


class Workers:
    """The processes of a baseline program and their current step."""

    def __init__(self) -> None:
        self._counter = mmap.mmap(-1, _COUNTER.size)
        self._ready_read, self._ready_write = os.pipe()
        self._start_read, self._start_write = os.pipe()
        self._begun = time.monotonic()
        self._children: dict[int, str] = {}

    # Called in the worker processes.

    def ready(self) -> None:
        """Report that this process is connected, and wait for the start."""
        os.write(self._ready_write, b".")
        os.close(self._start_write)
        os.read(self._start_read, 1)

    def made(self, step: int) -> None:
        """Publish the number of a completed step."""
        _COUNTER.pack_into(self._counter, 0, step)

    # Called in the main process.

    def serve(self, roles: Mapping[str, Role]) -> int:
        """Fork the roles, start them, answer requests until standard input closes; return the exit code."""
        libc = ctypes.CDLL(None)
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        gc.collect()
        gc.freeze()
        try:
            for name, role in roles.items():
                self._fork(name, role, libc)
            return self._answer() if self._meet() else 1
        finally:
            for pid in self._children:
                os.kill(pid, signal.SIGKILL)
            for pid in self._children:
                os.waitpid(pid, 0)

    def _fork(self, name: str, role: Role, libc: ctypes.CDLL) -> None:
        parent = os.getpid()
        pid = os.fork()
        if pid:
            self._children[pid] = name
            return
        try:
            libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
            libc.prctl(_PR_SET_NAME, name.encode(), 0, 0, 0)
            if os.getppid() == parent:
                gc.disable()
                role(self)
        except BaseException:  # noqa: BLE001 - a forked process must not return
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(1)

    def _meet(self) -> bool:
        """Wait until all processes are ready, start them, and report; return False if one ends or time runs out."""
        waiting = len(self._children)
        while waiting:
            readable, _, _ = select.select([self._ready_read, 0], [], [], 0.5)
            if self._ready_read in readable:
                waiting -= len(os.read(self._ready_read, waiting))
            elif 0 in readable or self._has_dead_worker():
                return False
            elif time.monotonic() - self._begun > _START_SECONDS:
                sys.stderr.write(f"{waiting} processes are not connected after {_START_SECONDS:g} s\n")
                return False
        os.close(self._start_write)
        _say(event="started", start_seconds=time.monotonic() - self._begun)
        return True

    def _answer(self) -> int:
        while True:
            readable, _, _ = select.select([0], [], [], 0.5)
            if readable:
                if not os.read(0, 4096):
                    return 0
                _say(event="step", step=_COUNTER.unpack_from(self._counter)[0], time=time.monotonic())
            elif self._has_dead_worker():
                return 1

    def _has_dead_worker(self) -> bool:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid:
            sys.stderr.write(f"{self._children.pop(pid)} exited with {os.waitstatus_to_exitcode(status)}\n")
        return bool(pid)


def _say(**facts: object) -> None:
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


def arguments() -> argparse.ArgumentParser:
    """Return the argument parser of all baseline programs."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=int, required=True)
    return parser
