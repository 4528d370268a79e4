"""The sources of live pages: a run, from its start to its bag, or a swarm that is known only by its messages.

As a program it serves the page of a run until standard input ends; `swarmabs_view.viewers` starts it.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.run_folder import RunFolder
from swarmabs_bag.shown.recorded_swarm import read_swarm
from swarmabs_bag.shown.swarm_state import SwarmState
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.orchestration.run_files import (
    RunOverError,
    environment_of_run,
    is_realtime,
    is_running,
    read_processes,
    read_progress,
)
from swarmabs_run.processes import ProcessMonitor
from swarmabs_run.simulation import Network, nodes_in_process
from swarmabs_run.tracing_files import tracing_files_removed
from swarmabs_view.facts import hello_of
from swarmabs_view.live import MOST_PLACES, LiveSession, LiveView
from swarmabs_view.playback import PlaybackSession, evenly, open_recording, places
from swarmabs_view.protocol import VERSION, Health, Process, Seek
from swarmabs_view.server import serve
from swarmabs_view.session import MOST_POINTS
from swarmabs_view.steering_bridge import SteeredSession, SteeringBridge

with tracing_files_removed():
    import rclpy

    from swarmabs_ros.start import SwarmNode, initialise
    from swarmabs_view.listener import DiagnosticsListener, Listener

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from swarmabs_bag.shown.swarm_state import Instant
    from swarmabs_config.scenario import Scenario
    from swarmabs_view.playback import Recording
    from swarmabs_view.presenter import Placed
    from swarmabs_view.session import Session

NAMESPACE = re.compile(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+")
HEALTH_INTERVAL = 2.0
"""Time between two queries of the processes, s."""
FETCH_INTERVAL = 1.0
"""Time between two attempts to read the beginning of a run from its bag, s; steps are written within a second."""
LARGEST_FETCH = 2**28
"""Size of a bag, bytes, beyond which its beginning is not read during the run, because that would take too long."""
WAIT_INTERVAL = 0.1
"""Time between two checks for the start or the summary of a run, s."""
NICENESS = 5
"""Lower priority than that of the run, for machines with few cores."""
SUMMARY_SECONDS = 10.0
"""Time within which a run must write its summary after its orchestrator has ended, s."""


def first_step(scenario: Scenario) -> SwarmState:
    """Return what is shown of the first step of a run in lockstep; raises `RunError` if it fails."""
    state, network = SwarmState.of(scenario), Network(nodes_in_process(scenario).values())
    network.start()
    for message in network.deliver(lambda message: message.step > 0):
        state.add(message)
    return state


class RunView:
    """A run, from its start to its bag; a page that knows the token can steer it."""

    def __init__(self, folder: Path, token: str | None = None) -> None:
        self._folder = RunFolder(folder)
        self._scenario: Scenario | None = None
        self._recording: Recording | None = None
        self._live = LiveView(hello_of("run", folder.name, str(folder)), SwarmState())
        self._live.text = "the processes are starting"
        self._bridge = None if token is None else SteeringBridge(folder, token)

    def session(self) -> Session:
        """Return the session of a new page."""
        if self._bridge is None:
            return LiveSession(self._live, self._playback)
        return SteeredSession(self._live, self._playback, self._bridge)

    async def steer(self) -> None:
        """Track the settings of a steerable run; never returns."""
        await (asyncio.Event().wait() if self._bridge is None else self._bridge.follow())

    async def follow(self) -> None:
        """Follow the run to its end, then show its bag; never returns."""
        processes = await self._started()
        environment = None if processes is None else self._environment()
        if processes is not None and environment is not None:
            os.environ.update(environment)
            os.nice(NICENESS)
            tasks = [asyncio.ensure_future(task) for task in (self._watch(processes), self._pause(), self._fetch())]
            try:
                await listen(self._live, "/", self._over)
            finally:
                for task in tasks:
                    task.cancel()
        self._live.phase, self._live.text = "ended", "the run has ended"
        await self._end()
        await asyncio.Event().wait()

    async def _started(self) -> Mapping[str, int] | None:
        """Wait until all processes have discovered each other; return their ids, None if the run has ended before.

        The view must not join earlier: a run begins when every node has discovered the number of its counterparts, and
        the view is none.
        """
        expected = False
        while not self._folder.summary.exists():
            with suppress(InputError):  # not completely written yet
                if self._scenario is None and self._folder.logs.is_dir():  # created before the scenario is written
                    await self._begin()
                if self._scenario is not None and not expected:
                    await self._expect(self._scenario)
                    expected = True
            processes = read_processes(self._folder.path)
            if self._scenario is not None and processes is not None:
                return processes
            await asyncio.sleep(WAIT_INTERVAL)
        return None

    async def _begin(self) -> None:
        scenario, place = find_scenario(str(self._folder.scenario)), str(self._folder.path)
        hello = await asyncio.to_thread(hello_of, "run", scenario.name, place, scenario)
        self._live.learn(hello, SwarmState.of(scenario))
        self._scenario = scenario

    async def _expect(self, scenario: Scenario) -> None:
        """Show the first step, which in lockstep is known in advance: it may be long before a paused run repeats it."""
        if not is_realtime(self._folder.path):
            with suppress(RunError):
                self._live.expect(await asyncio.to_thread(first_step, scenario))

    async def _fetch(self) -> None:
        """Read the steps before the first that was received of all robots from the bag that is being written."""
        while self._live.heard_since != 0:
            await asyncio.sleep(FETCH_INTERVAL)
            first = self._live.heard_since
            if first is None:
                continue
            with suppress(InputError, DamagedBagError, OSError):  # not written yet
                if sum(file.stat().st_size for file in self._folder.bag.iterdir()) > LARGEST_FETCH:
                    return
                recorded = await asyncio.to_thread(self._recorded, first)
                if recorded is not None:
                    self._live.begin(*recorded, first)
                    return

    def _recorded(self, first: int) -> tuple[list[Instant], list[Placed]] | None:
        """Return the recorded data before a step, None if it is not written yet."""
        swarm = read_swarm(self._folder.path)
        steps, period = swarm.arrays.step, swarm.scenario.period
        if not len(swarm) or steps[-1] < first - 1:
            return None
        # Times are those of the steps, as for received messages.
        instants = [swarm.instant(row) for row in evenly(len(swarm), MOST_POINTS)]
        placed = places(swarm, evenly(len(swarm), MOST_PLACES))
        return (
            [instant._replace(time=instant.step * period) for instant in instants],
            [place._replace(time=place.step * period) for place in placed],
        )

    async def _watch(self, processes: Mapping[str, int]) -> None:
        monitor = ProcessMonitor(processes)
        while True:
            states = await asyncio.to_thread(monitor.states)
            self._live.health = Health(processes=[Process(**state._asdict()) for state in states])
            await asyncio.sleep(HEALTH_INTERVAL)

    async def _pause(self) -> None:
        """Track whether the run is paused, so that its silence is none."""
        while True:
            progress = read_progress(self._folder.logs)
            self._live.paused = progress is not None and progress.phase == "paused"
            await asyncio.sleep(WAIT_INTERVAL)

    def _environment(self) -> dict[str, str] | None:
        """Return the environment of the run's network, None if the run has ended."""
        try:
            return environment_of_run(self._folder.path)
        except RunOverError:
            return None

    def _over(self) -> bool:
        return self._folder.summary.exists() or not is_running(self._folder.path)

    async def _end(self) -> None:
        """Show the bag, if it can be read."""
        for _ in range(round(SUMMARY_SECONDS / WAIT_INTERVAL)):
            if self._folder.summary.exists():
                break
            await asyncio.sleep(WAIT_INTERVAL)
        else:
            self._live.text = "the run has ended without a summary"
            return
        try:
            self._live.text = f"the run has ended: {json.loads(self._folder.summary.read_bytes())['status']}"
            if self._folder.bag.exists():
                self._recording = await asyncio.to_thread(open_recording, self._folder.path)
        except (InputError, DamagedBagError, OSError, ValueError, KeyError) as error:
            self._live.text = f"the run has ended; its bag cannot be shown: {error}"

    def _playback(self) -> PlaybackSession | None:
        if self._recording is None:
            return None
        session = PlaybackSession(self._recording)
        session.control(Seek(v=VERSION, type="seek", step=2**63 - 1))
        return session


class SwarmView:
    """A swarm in a namespace of the ROS domain of the environment."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        place = f"namespace {namespace} of ROS domain {domain}"
        self._live = LiveView(hello_of("swarm", f"swarm {namespace}", place), SwarmState())

    def session(self) -> LiveSession:
        """Return the session of a new page."""
        return LiveSession(self._live)

    async def follow(self) -> None:
        """Listen; never returns."""
        await listen(self._live, self._namespace, lambda: False)


def show_live(target: str, listener: socket.socket, ready: Callable[[str], None]) -> None:
    """Serve a running swarm until the user ends it; parameters and errors as for `view_live`."""
    folder = Path(target)
    shown: RunView | SwarmView
    if (folder / "logs").is_dir():
        environment_of_run(folder)  # which is refused if the run has ended
        shown = RunView(folder)
    elif NAMESPACE.fullmatch(target):
        shown = SwarmView(target)
    else:
        raise InputError(
            f"--live {target} is neither a run folder nor a namespace such as /swarm_a or /; give one of them"
        )
    serve(listener, shown.session, shown.follow, ready=ready)


async def listen(live: LiveView, namespace: str, over: Callable[[], bool]) -> None:
    """Join the ROS domain of the environment, and feed a view with the messages of a swarm until it has ended."""
    initialise("view", ["--ros-args", "--disable-external-lib-logs", "-r", f"__ns:={namespace}"])
    node = SwarmNode(f"view_{os.getpid()}")
    try:
        await live.listen(Listener(node, len(live.state.robots)), DiagnosticsListener(node), over)
    finally:
        node.destroy_node()  # type: ignore[no-untyped-call]
        rclpy.try_shutdown()


async def closed(descriptor: int) -> None:
    """Wait until the other end of a pipe is closed."""
    loop = asyncio.get_running_loop()
    end = asyncio.Event()

    def read() -> None:
        with suppress(BlockingIOError):
            if not os.read(descriptor, 4096):
                loop.remove_reader(descriptor)
                end.set()

    loop.add_reader(descriptor, read)
    try:
        await end.wait()
    finally:
        loop.remove_reader(descriptor)


def main() -> int:
    """Serve the page of a run until standard input ends."""
    folder, descriptor = sys.argv[1:]
    run = RunView(Path(folder), sys.stdin.buffer.readline().decode().strip() or None)
    with socket.socket(fileno=int(descriptor)) as listener:
        serve(listener, run.session, run.follow, run.steer, lambda: closed(0))
    return 0


if __name__ == "__main__":
    sys.exit(main())
