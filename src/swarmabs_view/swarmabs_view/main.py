"""Views from the first request to the last, as commands start them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_view.playback import PlaybackSession, open_recording
from swarmabs_view.ports import bound, need_web_server

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def view_bag(path: Path, *, namespace: str | None, port: int, ready: Callable[[str], None]) -> None:
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
    need_web_server()
    from swarmabs_view.server import serve  # noqa: PLC0415 - needs aiohttp

    recording = open_recording(path, namespace=namespace)
    _ = recording.hello, recording.curves, recording.events  # made before the first page asks
    with bound(port) as listener:
        serve(listener, lambda: PlaybackSession(recording), ready=ready)


def view_live(target: str, *, port: int, ready: Callable[[str], None]) -> None:
    """Show a running swarm until the user has seen enough.

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
    need_web_server()
    from swarmabs_view.sources import show_live  # noqa: PLC0415 - needs aiohttp and the whole of ROS

    with bound(port) as listener:
        show_live(target, listener, ready)
