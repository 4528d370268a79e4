"""Follows a run by its folder: waits for its start, listens while it goes on, and shows its bag when it is over."""

from __future__ import annotations

import asyncio
import json
import os
from contextlib import suppress
from typing import TYPE_CHECKING

from swarmabs_bag.run_folder import RunFolder
from swarmabs_config import configure
from swarmabs_config.scenarios import find_scenario
from swarmabs_core.errors import InputError
from swarmabs_core.swarm_state import SwarmState
from swarmabs_run.orchestration.looking_in import RunOverError, environment_of_run, goes_on, read_processes
from swarmabs_run.orchestration.tracing_files import tracing_files_removed
from swarmabs_view.facts import UNKNOWN, scenario_facts
from swarmabs_view.health import ProcessWatch
from swarmabs_view.protocol import Hello, Seek
from swarmabs_view.wheel import SteeredSession, Wheel

with tracing_files_removed():
    from swarmabs_view.live import Listener, LiveSession, LiveView

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from swarmabs_view.playback import PlaybackSession, Recording
    from swarmabs_view.server import Session

HEALTH_INTERVAL = 2.0
"""Time, s, between two looks at the processes."""
WAIT_INTERVAL = 0.1
"""Time, s, between two looks whether a run has begun, or its summary is written."""
NICENESS = 5
"""Where cores are scarce, those who look wait for those who work."""
SUMMARY_SECONDS = 10.0
"""Time, s, that a run whose orchestrator has ended may take to leave its summary."""


class RunView:
    """A run, from before its start to its bag.

    Parameters
    ----------
    folder : Path
        Its folder.
    token : str, optional
        What a page must know to steer it; without one, pages only look.
    """

    def __init__(self, folder: Path, token: str | None = None) -> None:
        self._folder = RunFolder(folder)
        self._recording: Recording | None = None
        hello = Hello(
            source="run",
            title=folder.name,
            place=str(folder),
            playback=False,
            **UNKNOWN,
        )
        self._live = LiveView(hello, SwarmState())
        self._live.text = "the processes start"
        self._wheel = None if token is None else Wheel(folder, token)

    def session(self) -> Session:
        """Return what a new page sees."""
        session = LiveSession(self._live, self._playback)
        return session if self._wheel is None else SteeredSession(session, self._wheel)

    async def steer(self) -> None:
        """Know what holds in a run that is steered; never ends."""
        await (asyncio.Event().wait() if self._wheel is None else self._wheel.follow())

    async def follow(self) -> None:
        """Follow the run to its end, then for ever show its bag."""
        processes = await self._started()
        environment = None if processes is None else self._environment()
        if processes is not None and environment is not None:
            os.environ.update(environment)
            listener = Listener("/", len(self._live.state.robots))
            os.nice(NICENESS)
            watch = asyncio.ensure_future(self._watch(processes))
            try:
                await self._live.listen(listener, self._over)
            finally:
                watch.cancel()
                listener.close()
        self._live.phase, self._live.text = "ended", "the run has ended"
        await self._end()
        await asyncio.Event().wait()

    async def _started(self) -> Mapping[str, int] | None:
        """Wait until all processes have met; return their ids, None if the run has ended before.

        Not before: a run begins when every node has met as many others as it has counterparts, and this is none.
        """
        known = False
        while not self._folder.summary.exists():
            if not known and self._folder.logs.is_dir():  # which is made before the scenario is written
                with suppress(InputError):  # not written to its end yet
                    await self._begin()
                    known = True
            processes = read_processes(self._folder.path)
            if known and processes is not None:
                return processes
            await asyncio.sleep(WAIT_INTERVAL)
        return None

    async def _begin(self) -> None:
        scenario = find_scenario(str(self._folder.scenario))
        facts = await asyncio.to_thread(scenario_facts, scenario)
        hello = Hello(source="run", title=scenario.name, place=str(self._folder.path), playback=False, **facts)
        self._live.learn(hello, configure.swarm_state(scenario))

    async def _watch(self, processes: Mapping[str, int]) -> None:
        watch = ProcessWatch(processes)
        while True:
            self._live.health = await asyncio.to_thread(watch.look)
            await asyncio.sleep(HEALTH_INTERVAL)

    def _environment(self) -> dict[str, str] | None:
        """Return the environment of the run's network, None if the run has just ended."""
        try:
            return environment_of_run(self._folder.path)
        except RunOverError:
            return None

    def _over(self) -> bool:
        return self._folder.summary.exists() or not goes_on(self._folder.path)

    async def _end(self) -> None:
        """Show the bag, if there is one that can be read."""
        for _ in range(round(SUMMARY_SECONDS / WAIT_INTERVAL)):
            if self._folder.summary.exists():
                break
            await asyncio.sleep(WAIT_INTERVAL)
        else:
            self._live.text = "the run has ended without a summary"
            return
        # Slow to import, and not needed before.
        from swarmabs_bag.errors import DamagedBagError  # noqa: PLC0415
        from swarmabs_view.playback import open_recording  # noqa: PLC0415

        try:
            self._live.text = f"the run has ended: {json.loads(self._folder.summary.read_bytes())['status']}"
            if self._folder.bag.exists():
                recording = await asyncio.to_thread(open_recording, self._folder.path)
                await asyncio.to_thread(lambda: (recording.hello, recording.curves))
                self._recording = recording
        except (InputError, DamagedBagError, OSError, ValueError, KeyError) as error:
            self._live.text = f"the run has ended; its bag cannot be shown: {error}"

    def _playback(self) -> PlaybackSession | None:
        if self._recording is None:
            return None
        from swarmabs_view.playback import PlaybackSession  # noqa: PLC0415 - as above

        session = PlaybackSession(self._recording)
        session.control(Seek(v=1, type="seek", step=2**63 - 1))
        return session


def check_running(folder: Path) -> None:
    """Refuse the folder of a run that is over.

    Raises
    ------
    InputError
        If it is over, or no run's folder.
    """
    try:
        environment_of_run(folder)
    except RunOverError as error:
        raise InputError(f"{error}; view its bag without --live") from None
