"""``swarm view``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.options import WholeNumber, examples, namespace_option
from swarmabs_cli.output import open_page
from swarmabs_view.playback import view_bag
from swarmabs_view.terminal import watch_run
from swarmabs_view.viewers import view_live


@click.command(
    epilog=examples(
        "view runs/pd_het_4-001 --open", "view --live runs/pd_het_4-001", "view --live runs/pd_het_4-001 --terminal"
    )
)
@click.argument("bag", required=False, type=click.Path(path_type=Path), metavar="[BAG]")
@click.option(
    "--live",
    metavar="RUN|NAMESPACE",
    help="Show a running swarm: the folder of a run, or a namespace in this ROS domain.",
)
@click.option("--terminal", is_flag=True, help="With --live RUN: show progress and processes in this terminal.")
@click.option("--port", type=WholeNumber(0, 65535), default=0, help="Port of the page.  [default: any free one]")
@click.option("--open", "open_browser", is_flag=True, help="Open the browser.")
@namespace_option
def view(
    bag: Path | None, live: str | None, port: int, *, terminal: bool, open_browser: bool, namespace: str | None
) -> int:
    """Show a bag or a running swarm in the browser, or the processes of a run in the terminal.

    The page is served on 127.0.0.1 only and needs no network. Viewing never changes or delays a run. Press Ctrl-C to
    stop.
    """
    if (bag is None) == (live is None):
        raise click.UsageError("Name either a bag, or a running swarm with --live.")
    if live is not None and namespace is not None:
        raise click.UsageError("--namespace is for bags; name the namespace with --live instead.")

    if terminal:
        if live is None or open_browser or port:
            raise click.UsageError("--terminal needs --live RUN, and cannot be combined with --port and --open.")
        watch_run(Path(live))
        return 0

    def ready(url: str) -> None:
        click.echo(url)
        click.echo("press Ctrl-C to stop", err=True)
        if open_browser:
            open_page(url)

    if bag is not None:
        view_bag(bag, namespace=namespace, port=port, ready=ready)
    else:
        view_live(str(live), port=port, ready=ready)
    return 0
