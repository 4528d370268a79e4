"""``swarm demo``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

import click

from swarmabs_cli.options import WholeNumber, examples, output_option
from swarmabs_cli.run.run import run
from swarmabs_run.ending import end_grace
from swarmabs_run.orchestration.launcher_process import LauncherProcess

if TYPE_CHECKING:
    from swarmabs_cli.launched import Parameters


class Show(NamedTuple):
    """How a swarm of a size is shown: its scenario, control period (s), robots per process, and positions (m).

    The larger swarms share processes, and the largest takes steps of 20 ms, so that two cores keep up with real time.
    At the positions, by their paths in the scenario, the swarm's inertia is five to fifteen times the desired one: its
    abstract state is far from the curve of desired states, and returns to it within about two seconds.
    """

    scenario: str
    step: float
    agents_per_process: int
    beside: dict[str, float]


SHOWS = {
    "4": Show("arise_het_4", 0.01, 1, {f"swarm.agents.{index}.position": (-1) ** index * 0.3 for index in range(4)}),
    "20": Show("arise_het_20", 0.01, 10, {"swarm.generate.position": 0.25}),
    "200": Show("arise_het_200", 0.02, 50, {"swarm.generate.position": 0.06}),
}
SWING = {
    "controller.trajectory.amplitude": 0.25,
    "controller.trajectory.angular_frequency": 0.4,
    "plane.end_stop": 1.0,
}
"""The plane swings visibly, slowly enough for every swarm, and survives a push too many on its end stops."""


def overrides(show: Show, *, beside: bool) -> dict[str, float]:
    """Return the changed values of the scenario, of a start beside the curve of desired states or of the usual one."""
    return {**SWING, "step": show.step, **(show.beside if beside else {})}


@click.command(epilog=examples("demo", "demo 200", "demo 20 --minutes 45"))
@click.argument("robots", type=click.Choice(tuple(SHOWS)), default="4")
@click.option("--minutes", type=WholeNumber(1, 180), default=30, show_default=True, help="Length of the show.")
@click.option("--no-browser", is_flag=True, help="Print the addresses of the page without opening a browser.")
@output_option("Folder of the results; of the next runs, with a number.  [default: runs/NAME-NNN]")
def demo(robots: str, minutes: int, output: Path | None, *, no_browser: bool) -> int:
    """Show a swarm live in the browser, to watch and to disturb.

    The robots, by default 4, make the plane follow a sine in real time; 20 and 200 share processes. On the page you
    push the plane, kill robots, let them leave, shift the reference and pause. You can also start again, as before or
    with the robots beside the curve of desired states, where the run waits to be resumed: the run ends and the next
    one starts, in a folder of its own on the same page. The last run ends after --minutes or with Ctrl-C; each is
    recorded like any other. On a terminal the page then plays the last bag until you press Ctrl-C again.
    """
    end_grace()
    show = SHOWS[robots]
    number = 0

    def following(request: str | None) -> tuple[Parameters, bool]:
        nonlocal number
        number += 1
        beside = request == "restart_beside"
        words = [show.scenario, "--steer", "--rate", "1", "--duration", str(60 * minutes)]
        words += ["--agents-per-process", str(show.agents_per_process)]
        for name, value in overrides(show, beside=beside).items():
            words += ["--set", f"{name}={value}"]
        if output is not None:
            words += ["-o", str(output if number == 1 else output.with_name(f"{output.name}-{number}"))]
        options = cast("Parameters", run.make_context(run.name, words).params)
        # Beside the curve the run waits to be resumed, because a page needs longer to show it than the swarm to return.
        return options, beside

    with LauncherProcess("lockstep") as launcher:
        from swarmabs_cli.launched import run_scenarios  # noqa: PLC0415 - loaded while the launcher loads the nodes

        return run_scenarios(launcher, following, open_browser=not no_browser)
