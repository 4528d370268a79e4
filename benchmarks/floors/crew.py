"""What the floor programs share: the messages as bytes, the processes, and how they are measured.

A floor program moves the messages of a run between as many processes as a run has, and does nothing else: no
mathematics, no checks, no recording. It shares no code with the product. Its main process imports everything, forks one
process per role, waits until all have met and gives the start. From then on it answers every line on its standard input
with one line of JSON on its standard output that says which step it is, and at the end of its standard input it kills
and reaps its processes and ends. No process or file outlives it, however it ends.
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

    Role = Callable[["Crew"], None]

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
"""Size of every message, bytes: those of the product."""


def blank(name: str, agent: int = 0) -> bytearray:
    """Return a message whose numbers are all zero but for the robot's id."""
    message = bytearray(SIZES[name])
    _HEAD.pack_into(message, 0, b"\x00\x01\x00\x00", 0, 0, 6, b"plane\x00", 0)
    if agent:
        struct.pack_into("<H", message, _AGENT_AT, agent)
    return message


def stamped(message: bytearray, step: int) -> bytes:
    """Put the step into a message and return it as it is sent."""
    _STEP.pack_into(message, _STEP_AT, step)
    return bytes(message)


def step_of(data: bytes) -> int:
    """Return the step of a message."""
    step: int = _STEP.unpack_from(data, _STEP_AT)[0]
    return step


def agent_of(data: bytes) -> int:
    """Return the robot from which a message comes."""
    return data[_AGENT_AT] | data[_AGENT_AT + 1] << 8


class Patience:
    """How long to wait before sending again: several times what a step took, since too early makes a storm."""

    def __init__(self) -> None:
        self._last = time.monotonic()
        self.seconds = LONGEST_PATIENCE

    def step(self) -> None:
        """Note that a step was made."""
        now = time.monotonic()
        self.seconds = min(LONGEST_PATIENCE, max(SHORTEST_PATIENCE, 4.0 * (now - self._last), 0.9 * self.seconds))
        self._last = now


class Crew:
    """The processes of a floor program, and the step they are at."""

    def __init__(self) -> None:
        self._counter = mmap.mmap(-1, _COUNTER.size)
        self._ready_read, self._ready_write = os.pipe()
        self._start_read, self._start_write = os.pipe()
        self._begun = time.monotonic()
        self._children: dict[int, str] = {}

    # In the processes of the roles.

    def ready(self) -> None:
        """Say that this process has met all it needs, and wait for the start."""
        os.write(self._ready_write, b".")
        os.close(self._start_write)
        os.read(self._start_read, 1)

    def made(self, step: int) -> None:
        """Note that a step is made."""
        _COUNTER.pack_into(self._counter, 0, step)

    # In the main process.

    def serve(self, roles: Mapping[str, Role]) -> int:
        """Fork the roles, give the start, answer until standard input ends; return the exit code."""
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
        except BaseException:  # noqa: BLE001 - it must end here, whatever it is
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(1)

    def _meet(self) -> bool:
        """Wait until all processes are ready, start them, and report; return False if that is not to be."""
        waiting = len(self._children)
        while waiting:
            readable, _, _ = select.select([self._ready_read, 0], [], [], 0.5)
            if self._ready_read in readable:
                waiting -= len(os.read(self._ready_read, waiting))
            elif 0 in readable or self._someone_died():
                return False
            elif time.monotonic() - self._begun > _START_SECONDS:
                sys.stderr.write(f"{waiting} processes have not met all others in {_START_SECONDS:g} s\n")
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
            elif self._someone_died():
                return 1

    def _someone_died(self) -> bool:
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid:
            sys.stderr.write(f"{self._children.pop(pid)} ended with {os.waitstatus_to_exitcode(status)}\n")
        return bool(pid)


def _say(**facts: object) -> None:
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


def arguments() -> argparse.ArgumentParser:
    """Return the command line that all floor programs have."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=int, required=True)
    return parser
