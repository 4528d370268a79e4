"""``swarm markers``, and the options of ``swarm run`` that show a run to RViz and Foxglove."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from swarmabs_cli.namespace import namespace_option

if TYPE_CHECKING:
    from collections.abc import Callable

FOXGLOVE_PORT = 8765
"""The one that Foxglove offers by itself."""


def shown_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that show a run to RViz and Foxglove."""
    decorators = (
        click.option("--markers", is_flag=True, help="Publish markers, joint state and URDF for RViz and Foxglove."),
        click.option("--foxglove", is_flag=True, help="Serve the run to Foxglove by WebSocket, on this machine."),
        click.option(
            "--foxglove-port",
            type=click.IntRange(1, 65535),
            default=FOXGLOVE_PORT,
            show_default=True,
            help="With --foxglove: TCP port.",
        ),
    )
    for decorator in reversed(decorators):
        function = decorator(function)
    return function


def shown_beside(options: dict[str, Any], *, clock: bool) -> Callable[[Path], AbstractContextManager[None]]:
    """Take these options out of those of a run; return what shows a run in a folder for the time of a block.

    With `clock` the run's time is not that of the machine, and is published.
    """
    markers, foxglove, port = (options.pop(name) for name in ("markers", "foxglove", "foxglove_port"))
    if not (markers or foxglove):
        return lambda _: nullcontext()
    from swarmabs_view.ports import check_foxglove  # noqa: PLC0415 - slow, not for --help
    from swarmabs_view.viewer_process import markers_viewer  # noqa: PLC0415

    if foxglove:
        check_foxglove(port)
        click.echo(f"Foxglove: open a connection to ws://127.0.0.1:{port}", err=True)
    served = port if foxglove else None
    return lambda folder: markers_viewer(folder, ros=markers, foxglove_port=served, clock=clock)


@click.command()
@click.argument("bag", type=click.Path(path_type=Path), metavar="BAG")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="New folder for the bag.")
@click.option(
    "--rate",
    type=click.FloatRange(0.1, 1000.0),
    default=30.0,
    show_default=True,
    metavar="HZ",
    help="Most frames per second of recorded time.",
)
@namespace_option
def markers(bag: Path, output: Path, rate: float, namespace: str | None) -> None:
    """Write a bag once more, with markers, joint state and URDF, for Foxglove and RViz."""
    from swarmabs_run.orchestration.tracing_files import tracing_files_removed  # noqa: PLC0415 - not for --help

    with tracing_files_removed():
        from swarmabs_view.visualization.bag import write_markers  # noqa: PLC0415 - needs the whole of ROS

        click.echo(write_markers(bag, output, rate=rate, namespace=namespace))
