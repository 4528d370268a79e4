"""``swarm run``: its options; what it does is in `swarmabs_cli.launched`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from swarmabs_cli.options import Number, WholeNumber, examples, run_options
from swarmabs_core.errors import InputError
from swarmabs_run.ending import end_grace
from swarmabs_run.orchestration.launcher_process import LauncherProcess

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from swarmabs_cli.launched import Parameters

FOXGLOVE_PORT = 8765
"""The default port of Foxglove."""


@click.command(
    epilog=examples("run", "run pd_di_4 --set plane.angle=0.2 --duration 10", "run arise_het_20 --view --open")
)
@run_options
@click.option(
    "--agents-per-process",
    type=WholeNumber(1),
    default=1,
    show_default=True,
    help="Robots per process, for large simulations.",
)
@click.option(
    "--packed/--no-packed",
    default=None,
    help="Send broadcasts, and the robots' states for plane and recorder, as one message each.  "
    "[default: by the number of robots, as is faster]",
)
@click.option("--realtime", is_flag=True, help="Run in real time, as on robots, with simulated bodies.")
@click.option("--steer", is_flag=True, help="Accept changes from the command `steer` during the run.")
@click.option(
    "--rate",
    type=Number(0.0, min_open=True, max=1e6),
    help="With --steer: upper limit of simulated time per real time.  [default: none]",
)
@click.option("--view", is_flag=True, help="Show the run as a page in the browser.")
@click.option("--view-port", type=WholeNumber(0, 65535), help="With --view: port of the page.  [default: any]")
@click.option("--open", "open_browser", is_flag=True, help="With --view: open the browser.")
@click.option("--markers", is_flag=True, help="Publish markers, joint state and URDF for RViz and Foxglove.")
@click.option("--foxglove", is_flag=True, help="Serve the run to Foxglove on this machine (WebSocket).")
@click.option(
    "--foxglove-port",
    type=WholeNumber(1, 65535),
    default=FOXGLOVE_PORT,
    show_default=True,
    help="With --foxglove: TCP port.",
)
def run(**options: Unpack[Parameters]) -> int:
    """Run a scenario with one process per robot over DDS.

    SCENARIO is a built-in scenario (see `scenario list`), by default pd_het_4, a YAML file, or a bag, whose scenario is
    run again. Runs are in lockstep unless you pass --realtime. With --view on a terminal, the page stays open after the
    run and plays its bag until you press Ctrl-C.
    """
    end_grace()
    given = {
        "--packed": options["packed"],
        "--agents-per-process": options["agents_per_process"] > 1,
        "--steer": options["steer"],
    }
    if options["realtime"] and any(given.values()):
        option = next(name for name, there in given.items() if there)
        raise InputError(f"{option} cannot be combined with --realtime, it needs lockstep; remove one of them")
    if options["rate"] is not None and not options["steer"]:
        raise InputError("--rate needs --steer; add --steer, or remove --rate")
    if options["steer"] and options["no_bag"]:
        raise InputError("--steer cannot be combined with --no-bag, since changes are recorded; remove one of them")
    if not options["view"] and (options["view_port"] is not None or options["open_browser"]):
        option = "--open" if options["open_browser"] else "--view-port"
        raise click.UsageError(f"{option} needs --view; add --view, or remove {option}.")
    with LauncherProcess("realtime" if options["realtime"] else "lockstep") as launcher:
        from swarmabs_cli.launched import run_scenario  # noqa: PLC0415 - loaded while the launcher loads the nodes

        return run_scenario(launcher, options)
