"""The common ``main`` of all nodes in real time: parameters, the two threads, autostart, exit code.

A process can request a real-time priority and locked memory from the kernel, so that its steps are on time.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from rclpy.executors import SingleThreadedExecutor

from swarmabs_config.graph import REALTIME
from swarmabs_core.declaration import parameters_of
from swarmabs_core.errors import InputError, RunError
from swarmabs_ros.managed import RealtimeNode, one_line
from swarmabs_ros.parameters import declare_values, read
from swarmabs_ros.realtime import RealtimeLoop
from swarmabs_ros.runner import Settings
from swarmabs_ros.settings import RealtimeSettings
from swarmabs_ros.start import run_program
from swarmabs_ros.status import Heartbeat, notify
from swarmabs_ros.tuning import Tuning, gains_among

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_ros.managed import RealtimeSpec
    from swarmabs_ros.parameters import Table
    from swarmabs_ros.status import StatusChannel


COMMON = parameters_of(RealtimeSettings)
"""Parameters that every node in real time has."""


SWITCH_INTERVAL = 0.0005
"""Longest time, s, for which the thread that serves ROS holds the interpreter while a step is due."""
_ENDS_WITHIN = 5.0
_CLASSES = {"fifo": os.SCHED_FIFO, "rr": os.SCHED_RR}
_MCL_CURRENT, _MCL_FUTURE = 1, 2  # sys/mman.h on Linux, x86-64 and ARM


@dataclass(frozen=True, slots=True)
class RealtimeProgram:
    """The program of a node in real time.

    Parameters
    ----------
    name : str
        Its name in the graph, and its node name unless remapped.
    parameters : Table
        Its parameters beyond the common ones.
    make : callable
        Creates behaviour and endpoints from the parameters each time the node is configured.
    gains : tuple of str
        Names or prefixes of the parameters that may be set while the node is not active.
    """

    name: str
    parameters: Table
    make: Callable[[Settings, RealtimeNode], RealtimeSpec]
    gains: tuple[str, ...] = ()

    def __call__(self, args: list[str] | None = None) -> int:
        """Run until told to stop (SIGINT, SIGTERM); return the exit code of `run_program`."""
        return run_program(self.name, RealtimeNode, self._run, args)

    def _run(self, node: RealtimeNode, status: StatusChannel) -> None:
        tuning = _tuning(node, self.parameters, self.gains, status)
        _run(self.name, node, tuning, lambda: self.make(tuning.settings, node), status)


def _tuning(node: RealtimeNode, own: Table, gains: tuple[str, ...], status: StatusChannel) -> Tuning:
    table, values = read(node, COMMON, own)
    if values["await_epoch"]:
        status.send("ready")
        values["epoch_ns"] = status.wait_for_epoch()
    settable = gains_among(table, gains)
    declare_values(node, table, values, settable)
    return Tuning(Settings(values, node.get_namespace()), settable)


def _run(
    role: str, node: RealtimeNode, tuning: Tuning, make: Callable[[], RealtimeSpec], status: StatusChannel
) -> None:
    settings = tuning.settings
    common = settings.declared(RealtimeSettings)
    executor = SingleThreadedExecutor(context=node.context)
    loop = RealtimeLoop(node.failed, Heartbeat().beat, on_hang=lambda: _give_up(node))
    node.prepare(make, settings.endpoints(role, REALTIME), common.schedule, loop, executor, status, tuning)
    executor.add_node(node)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: loop.stop())
    refused: list[Exception] = []

    def start() -> None:
        if not node.bring_up():
            refused.append(node.failure or RunError("the node did not start"))
            loop.stop()

    server = Server(node, executor)
    sys.setswitchinterval(SWITCH_INTERVAL)
    server.start()
    try:
        schedule_threads(common.scheduling, common.priority)
        if common.lock_memory:
            lock_memory()
        if common.autostart:
            executor.create_task(start)
        else:
            notify("READY=1\nSTATUS=waiting for configuration")
        loop.run()
    finally:
        notify("STOPPING=1")
        server.end()
        node.end()
        executor.shutdown()
    problem = refused[0] if refused else node.failure
    if problem is not None:
        raise problem if isinstance(problem, (InputError, RunError)) else RunError(one_line(problem))


def _give_up(node: RealtimeNode) -> NoReturn:
    """Report why the main thread hangs, and end the process."""
    try:
        node.hung()
        sys.stderr.write(f"error: {node.failure}\n")
        sys.stderr.flush()
    finally:
        os._exit(1)


def schedule_threads(name: str, priority: int) -> None:
    """Set a scheduling class for all threads of this process, with a higher priority for the calling thread.

    The class `other` changes nothing. All threads need the class, because they deliver the messages, and one that holds
    the interpreter blocks the calling thread. Raises `InputError` if the process lacks the permission; the text states
    what it needs.
    """
    if name not in _CLASSES:
        return
    own = threading.get_native_id()
    try:
        for entry in Path("/proc/self/task").iterdir():
            thread = int(entry.name)
            with suppress(ProcessLookupError):  # the thread has ended in the meantime
                os.sched_setscheduler(thread, _CLASSES[name], os.sched_param(priority - (thread != own)))
    except OSError as error:
        raise InputError(
            f"parameter scheduling: this process may not use {name} priority {priority} ({error.strerror}); "
            f"allow it (systemd: LimitRTPRIO={priority}; otherwise the capability CAP_SYS_NICE), or use 'other'"
        ) from error


def lock_memory() -> None:
    """Lock all current and future memory of this process, so that it is not paged out.

    Raises `InputError` if the process lacks the permission; the text states what it needs.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        raise InputError(
            f"parameter lock_memory: this process may not lock its memory ({os.strerror(ctypes.get_errno())}); "
            "allow it (systemd: LimitMEMLOCK=infinity; otherwise the capability CAP_IPC_LOCK), or use false"
        )


class Server(threading.Thread):
    """The thread that serves ROS; an error of one callback is logged and does not end it."""

    def __init__(self, node: RealtimeNode, executor: SingleThreadedExecutor) -> None:
        super().__init__(name="ros", daemon=True)
        self._node, self._executor = node, executor
        self._ending = False

    def run(self) -> None:
        """Serve until `end`."""
        while not self._ending and self._node.context.ok():
            try:
                self._executor.spin_once()
            except Exception as error:  # noqa: BLE001 - the next request may succeed
                self._node.notes.error(f"a request failed: {one_line(error)}")

    def end(self) -> None:
        """Stop serving after the current request; raises `RunError` if that does not end."""
        self._ending = True
        self._executor.create_task(lambda: None)  # if only woken, it waits on for something to do
        self.join(_ENDS_WITHIN)
        if self.is_alive():
            raise RunError("the current request does not end")
