"""``swarm demo``."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import click

from swarmabs_cli.options import WholeNumber, examples, output_option
from swarmabs_run.ending import end_grace
from swarmabs_run.orchestration.launcher_process import LauncherProcess


class Show(NamedTuple):
    """How a swarm of a size is shown: its scenario, control period (s), and robots per process.

    The larger swarms share processes, and the largest takes steps of 20 ms, so that two cores keep up with real time.
    """

    scenario: str
    step: float
    agents_per_process: int


SHOWS = {
    "4": Show("arise_het_4", 0.01, 1),
    "20": Show("arise_het_20", 0.01, 10),
    "200": Show("arise_het_200", 0.02, 50),
}
SWING = {
    "controller.trajectory.amplitude": 0.25,
    "controller.trajectory.angular_frequency": 0.4,
    "plane.end_stop": 1.0,
}
"""The plane swings visibly, slowly enough for every swarm, and survives a push too many on its end stops."""


@click.command(epilog=examples("demo", "demo 200", "demo 20 --minutes 45"))
@click.argument("robots", type=click.Choice(tuple(SHOWS)), default="4")
@click.option("--minutes", type=WholeNumber(1, 180), default=30, show_default=True, help="Length of the show.")
@click.option("--no-browser", is_flag=True, help="Print the addresses of the page without opening a browser.")
@output_option("Folder of the results.  [default: runs/NAME-NNN]")
def demo(robots: str, minutes: int, output: Path | None, *, no_browser: bool) -> int:
    """Show a swarm live in the browser, to watch and to disturb.

    The robots, by default 4, make the plane follow a sine in real time; 20 and 200 share processes. On the page you can
    kill robots, let them leave, push the plane and shift its reference. The run ends after --minutes or with Ctrl-C. It
    is recorded like any other.
    """
    end_grace()
    show = SHOWS[robots]
    changes = {**SWING, "step": show.step}
    with LauncherProcess("lockstep") as launcher:
        from swarmabs_cli.launched import run_scenario  # noqa: PLC0415 - loaded while the launcher loads the nodes

        return run_scenario(
            launcher,
            scenario=show.scenario,
            bag_scenario=None,
            output=output,
            overrides=tuple(f"{name}={value}" for name, value in changes.items()),
            duration=str(60 * minutes),
            no_bag=False,
            max_bag_size=0,
            max_bag_duration=0,
            as_json=False,
            agents_per_process=show.agents_per_process,
            packed=None,
            realtime=False,
            steer=True,
            rate=1.0,
            view=True,
            view_port=None,
            open_browser=not no_browser,
            markers=False,
            foxglove=False,
            foxglove_port=0,
        )
