"""The process from which a run's nodes are forked.

It imports everything that the nodes need and starts no threads. Each node is a fork of it: forking takes milliseconds
and shares memory; starting a Python interpreter with rclpy takes a second. Commands arrive as lines of JSON on
standard input; the exits of the children go to the report pipe. When standard input closes, however the orchestrator
ended, every child is killed and reaped. If this process itself is killed, the kernel kills the children.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import inspect
import json
import os
import select
import signal
import sys
import time
import traceback
import warnings
from typing import TYPE_CHECKING, NoReturn

from swarmabs_config.graph import CONTROLLER, NODES, OBSERVER, PLANE, ROBOT, Driver
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.messages import TOPICS
from swarmabs_core.swarm_law import LAWS
from swarmabs_core.systems.interface import SYSTEMS
from swarmabs_ros.endpoints import ros_type
from swarmabs_ros.status import REPORT_FD
from swarmabs_run.ending import die_with_parent, end_grace
from swarmabs_run.tracing_files import tracing_files_removed

if TYPE_CHECKING:
    from swarmabs_run.orchestration.launcher_process import Order

LOADED_BY_SERVICES = ("numpy", "service_msgs.msg", "type_description_interfaces.msg")
"""Modules that rclpy loads when a node offers services, as real-time nodes do; loaded here, all nodes share them."""
CROWD = 8
"""With more nodes per core than this, nodes do not preempt each other for every message."""
_PR_SET_NAME = 15


class Launcher:
    """Forks nodes on request and reports their exits."""

    def __init__(self, report_fd: int) -> None:
        self._report_fd = report_fd
        self._children: dict[int, str] = {}
        self._pids: dict[str, int] = {}
        self._wake = os.pipe()
        self._grace = end_grace()

    def run(self) -> None:
        """Serve until standard input closes."""
        wake_read, wake_write = self._wake
        os.set_blocking(wake_write, False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(wake_write, warn_on_full_buffer=False)
        pending = b""
        while True:
            ready, _, _ = select.select([0, wake_read], [], [])
            if wake_read in ready:
                os.read(wake_read, 4096)
                self._reap(os.WNOHANG)
            if 0 in ready:
                data = os.read(0, 65536)
                if not data:
                    break
                *lines, pending = (pending + data).split(b"\n")
                for line in lines:
                    self._obey(json.loads(line))
        self._end()

    def _obey(self, order: Order) -> None:
        if order["command"] == "begin":
            _begin(order)
        elif order["command"] == "spawn":
            self._spawn(order)
        else:
            pid = self._pids.get(order["name"])
            if pid is not None:  # not reaped yet, so the id still belongs to the child
                os.kill(pid, order["signal"])

    def _spawn(self, order: Order) -> None:
        launcher = os.getpid()
        pid = os.fork()
        if pid == 0:
            self._become(order, launcher)
        self._children[pid] = order["name"]
        self._pids[order["name"]] = pid
        self._report("spawned", name=order["name"], child=pid)

    def _become(self, order: Order, launcher: int) -> NoReturn:
        """Turn the forked process into a node; it never returns to the launcher's loop."""
        code = 1
        try:
            die_with_parent(launcher)
            ctypes.CDLL(None).prctl(_PR_SET_NAME, order["name"].encode(), 0, 0, 0)
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            for descriptor in self._wake:
                os.close(descriptor)
            log = os.open(order["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            null = os.open(os.devnull, os.O_RDONLY)
            for source, target in ((null, 0), (log, 1), (log, 2)):
                os.dup2(source, target)
            os.close(log)
            os.close(null)
            os.environ.update(order["environment"])
            code = importlib.import_module(order["module"]).main(order["arguments"])
        except BaseException:  # noqa: BLE001 - every exception goes to the node's log and ends the child
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)

    def _reap(self, options: int) -> None:
        while self._children:
            pid, status = os.waitpid(-1, options)
            if pid == 0:
                return
            name = self._children.pop(pid)
            del self._pids[name]
            self._report("exited", name=name, child=pid, code=os.waitstatus_to_exitcode(status))

    def _end(self) -> None:
        for pid in self._children if self._grace else ():
            os.kill(pid, signal.SIGTERM)
        deadline = time.monotonic() + self._grace
        while self._children and time.monotonic() < deadline:
            self._reap(os.WNOHANG)
            time.sleep(0.01)
        for pid in self._children:
            os.kill(pid, signal.SIGKILL)
            os.kill(pid, signal.SIGCONT)
        self._reap(0)

    def _report(self, event: str, **details: object) -> None:
        line = json.dumps({"node": "launcher", "pid": os.getpid(), "event": event, **details}) + "\n"
        try:
            os.write(self._report_fd, line.encode())
        except BrokenPipeError:  # the orchestrator has ended, so standard input closes too
            return


def main() -> int:
    """Import all modules, then serve."""
    # The ROS tracing library runs two idle listener threads, which a fork may safely lose.
    warnings.filterwarnings("ignore", message=".*multi-threaded, use of fork", category=DeprecationWarning)
    driver = Driver(sys.argv[1])
    with tracing_files_removed(if_orphaned=True):
        for node in (PLANE, OBSERVER, CONTROLLER, ROBOT):
            importlib.import_module(NODES[node].modules[driver])
        for name in LOADED_BY_SERVICES if driver is Driver.REALTIME else ():
            importlib.import_module(name)
        for topic in TOPICS:
            ros_type(topic).__class__.__import_type_support__()
        # To name the caller of a log message, rclpy looks up the paths of all modules; the nodes inherit what is found.
        inspect.getmodule(inspect.currentframe())
        Launcher(int(os.environ[REPORT_FD])).run()
    return 0


def _begin(order: Order) -> None:
    """Prepare for a run: environment, log, modules and parts from packages, memory and scheduling."""
    os.environ.update(order["environment"])
    log = os.open(order["log"], os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for target in (1, 2):
        os.dup2(log, target)
    os.close(log)
    for module in order["modules"]:
        importlib.import_module(module)
    registries = {registry.group: registry for registry in (CONTROLLERS, LAWS, SYSTEMS)}
    for group, _, name in (plugin.partition(":") for plugin in order["plugins"]):
        registries[group].find(name)  # entry points are resolved once, not in every node
    gc.collect()
    gc.freeze()  # memory that the garbage collector does not touch stays shared with the children
    if order["processes"] > CROWD * len(os.sched_getaffinity(0)):
        # An arriving message does not preempt the running process: the receiver runs when that process waits, and
        # handles all messages that have arrived meanwhile. This halves the number of context switches.
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


if __name__ == "__main__":
    sys.exit(main())
