"""The frame of ``main`` of every node in real time: parameters, the two threads, autostart, exit code.

A process may ask the kernel for a real-time priority and for memory that stays in, so that its steps come in time.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from rclpy.executors import SingleThreadedExecutor

from swarmabs_config.graph import REALTIME
from swarmabs_core.declaration import parameters_of
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.base import Realtime, Schedule
from swarmabs_ros.managed import RealtimeNode, one_line
from swarmabs_ros.parameters import checked, declare_values, given_values, table_of
from swarmabs_ros.realtime import RealtimeLoop
from swarmabs_ros.runner import Settings
from swarmabs_ros.start import run_program
from swarmabs_ros.status import Heartbeat, notify
from swarmabs_ros.tuning import NO_SIM_TIME, SIM_TIME, Tuning, gains_among

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_ros.managed import RealtimeSpec
    from swarmabs_ros.status import StatusChannel

SCHEDULING = Parameter(
    "scheduling",
    "other",
    "scheduling of the node's threads: other, or a real-time class",
    choices=("other", "fifo", "rr"),
)
PRIORITY = Parameter(
    "priority",
    50,
    "priority within a real-time class of the thread that makes the steps; all others have one less",
    minimum=2,
    maximum=99,
)
LOCK_MEMORY = Parameter("lock_memory", default=False, description="whether to keep all memory from being paged out")

COMMON = (
    *parameters_of(Schedule),
    Parameter("await_epoch", default=False, description="whether whoever starts the node tells it the epoch"),
    *(parameter for parameter in parameters_of(Realtime) if parameter.name == "clock_tolerance"),
    Parameter("autostart", default=True, description="whether to configure and activate the node at once"),
    SCHEDULING,
    PRIORITY,
    LOCK_MEMORY,
)
"""Parameters that every node in real time has."""

SWITCH_INTERVAL = 0.0005
"""Longest time, s, for which the thread that serves ROS keeps the interpreter when a step is due."""
_ENDS_WITHIN = 5.0
_CLASSES = {"fifo": os.SCHED_FIFO, "rr": os.SCHED_RR}
_MCL_CURRENT, _MCL_FUTURE = 1, 2  # sys/mman.h on Linux, x86-64 and ARM

Table = tuple[Parameter | type, ...]


def choose(table: tuple[Parameter, ...], *names: str) -> tuple[Parameter, ...]:
    """Return parameters of a table by name: those of a lockstep node that mean the same here."""
    known = {parameter.name: parameter for parameter in table}
    return tuple(known[name] for name in names)


def run_realtime(
    name: str,
    table: Table,
    make: Callable[[Settings, RealtimeNode], RealtimeSpec],
    args: list[str] | None = None,
    *,
    gains: tuple[str, ...] = (),
) -> int:
    """Run a node in real time until it is told to stop (SIGINT, SIGTERM); return its exit code, as of `run_program`.

    Parameters
    ----------
    name : str
        Its name in the graph, and its own where none is remapped.
    table : tuple of Parameter or type
        Its parameters beyond the common ones, and the declarations from which further ones follow.
    make : callable
        Makes behaviour and endpoints from the parameters, each time the node is configured.
    gains : tuple of str
        Parameters, or what their names begin with, that may be set while the node is not active.
    """

    def body(node: RealtimeNode, status: StatusChannel) -> None:
        tuning = _tuning(node, table, gains, status)
        _run(name, node, tuning, lambda: make(tuning.settings, node), status)

    return run_program(name, RealtimeNode, body, args)


def _tuning(node: RealtimeNode, own: Table, gains: tuple[str, ...], status: StatusChannel) -> Tuning:
    if node.get_parameter(SIM_TIME).value:
        raise InputError(NO_SIM_TIME)
    table = table_of(given_values(node), COMMON, own)
    values = checked(node, table)
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
    executor = SingleThreadedExecutor(context=node.context)
    loop = RealtimeLoop(node.failed, Heartbeat().beat, on_hang=lambda: _give_up(node))
    node.prepare(make, settings.endpoints(role, REALTIME), settings.made(Schedule), loop, executor, status, tuning)
    executor.add_node(node)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: loop.stop())
    refused: list[Exception] = []

    def start() -> None:
        if not node.bring_up():
            refused.append(node.failure or RunError("the node does not start"))
            loop.stop()

    server = Server(node, executor)
    sys.setswitchinterval(SWITCH_INTERVAL)
    server.start()
    try:
        schedule_threads(settings.text(SCHEDULING.name), settings.integer(PRIORITY.name))
        if settings.flag(LOCK_MEMORY.name):
            lock_memory()
        if settings.flag("autostart"):
            executor.create_task(start)
        else:
            notify("READY=1\nSTATUS=waits to be configured")
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
    """End the process, whose main thread does not come back, once it is said why."""
    try:
        node.hung()
        sys.stderr.write(f"error: {node.failure}\n")
        sys.stderr.flush()
    finally:
        os._exit(1)


def schedule_threads(name: str, priority: int) -> None:
    """Give all threads of this process a scheduling class, the calling one a higher priority; `other` changes nothing.

    The others matter: they bring the messages, and one that has the interpreter keeps the calling thread waiting.
    Raises `InputError` if this process may not; the text says what it needs.
    """
    if name not in _CLASSES:
        return
    own = threading.get_native_id()
    try:
        for entry in Path("/proc/self/task").iterdir():
            thread = int(entry.name)
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.sched_setscheduler(thread, _CLASSES[name], os.sched_param(priority - (thread != own)))
    except OSError as error:
        raise InputError(
            f"parameter {SCHEDULING.name}: this process may not have {name} priority {priority} ({error.strerror}); "
            f"allow it (systemd: LimitRTPRIO={priority}; otherwise the capability CAP_SYS_NICE), or give 'other'"
        ) from error


def lock_memory() -> None:
    """Keep all memory of this process, present and future, from being paged out.

    Raises `InputError` if this process may not; the text says what it needs.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        raise InputError(
            f"parameter {LOCK_MEMORY.name}: this process may not lock its memory ({os.strerror(ctypes.get_errno())}); "
            "allow it (systemd: LimitMEMLOCK=infinity; otherwise the capability CAP_IPC_LOCK), or give false"
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
            except Exception as error:  # noqa: BLE001 - the next request may be served well
                self._node.notes.error(f"a request failed: {one_line(error)}")

    def end(self) -> None:
        """Serve no more, once what is being served is done; raises `RunError` if it does not end."""
        self._ending = True
        self._executor.wake()
        self.join(_ENDS_WITHIN)
        if self.is_alive():
            raise RunError("a request that is being served does not end")
