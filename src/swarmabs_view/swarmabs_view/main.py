"""Views from the first request to the last, as commands start them."""

from __future__ import annotations

import asyncio
import re
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine
    from socket import socket

    from swarmabs_view.server import Session

    Ready = Callable[[str], None]
    Work = Callable[[], Coroutine[None, None, None]]

_NAMESPACE = re.compile(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+")


def view_bag(path: Path, *, namespace: str | None, port: int, ready: Ready) -> None:
    """Show a bag until the user has seen enough.

    Parameters
    ----------
    path : Path
        A run folder, its ``bag/``, or an MCAP file.
    namespace : str, optional
        Which swarm to show if the bag holds several.
    port : int
        0 for any free one.
    ready : callable
        Told the address of the page.

    Raises
    ------
    InputError
        If the port is taken, or it is no bag of a swarm.
    DamagedBagError
        If it cannot be read.
    """
    from swarmabs_view.playback import PlaybackSession, open_recording  # noqa: PLC0415 - slow to import

    need_packages()
    recording = open_recording(path, namespace=namespace)
    _ = recording.hello, recording.curves, recording.events  # made before the first page asks
    with listening(port) as listener:
        serve(listener, lambda: PlaybackSession(recording), ready=ready)


def need_packages() -> None:
    """Refuse where the web server is not installed.

    Raises
    ------
    InputError
        If so.
    """
    try:
        import aiohttp  # noqa: F401, PLC0415
    except ImportError as error:
        raise InputError(
            "the view needs the Python package aiohttp, which ./scripts/swarm installs by itself; "
            f"with a ROS 2 of your own: {sys.executable} -m pip install aiohttp"
        ) from error


def listening(port: int) -> socket:
    """Return a listening socket; errors as of `swarmabs_view.server.bound`."""
    from swarmabs_view.server import bound  # noqa: PLC0415 - needs aiohttp

    return bound(port)


def serve(listener: socket, session: Callable[[], Session], *beside: Work, ready: Ready | None = None) -> None:
    """Serve pages until this process is asked to end, by a signal or by a task beside that is done.

    Parameters
    ----------
    listener : socket
        Bound to a port on 127.0.0.1.
    session : callable
        Makes what a new page sees.
    *beside : callable
        What goes on beside, as coroutines; the first that is done ends all.
    ready : callable, optional
        Told the address of the page once it is served.
    """
    from swarmabs_view.server import ViewServer, url_of  # noqa: PLC0415 - needs aiohttp

    async def main() -> None:
        loop = asyncio.get_running_loop()
        asked = asyncio.Event()
        previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        for number in previous:
            loop.add_signal_handler(number, asked.set)
        try:
            if ready is not None:
                ready(url_of(listener))
            await ViewServer(listener, session).run(asked.wait(), *(work() for work in beside))
        finally:
            for number, handler in previous.items():
                loop.remove_signal_handler(number)
                signal.signal(number, handler)

    with suppress(KeyboardInterrupt):
        asyncio.run(main())


def view_live(target: str, *, port: int, ready: Ready) -> None:
    """Show a swarm that goes on until the user has seen enough.

    Parameters
    ----------
    target : str
        Folder of a run, or a namespace of the ROS domain of the environment.
    port : int
        0 for any free one.
    ready : callable
        Told the address of the page.

    Raises
    ------
    InputError
        If it is neither, the run is over, or the port is taken.
    """
    need_packages()
    folder = Path(target)
    with listening(port) as listener:
        if (folder / "logs").is_dir():
            from swarmabs_view.following import RunView, check_running  # noqa: PLC0415 - needs the whole of ROS

            check_running(folder)
            run = RunView(folder)
            serve(listener, run.session, run.follow, ready=ready)
            return
        if not _NAMESPACE.fullmatch(target):
            raise InputError(f"--live {target}: neither the folder of a run nor a namespace such as /swarm_a, or /")
        from swarmabs_view.swarm import SwarmView  # noqa: PLC0415 - needs the whole of ROS

        swarm = SwarmView(target)
        serve(listener, swarm.session, swarm.follow, ready=ready)
