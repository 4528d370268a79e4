"""The command line ``swarm``. It parses, calls the library and prints; it decides nothing."""

from __future__ import annotations

from collections.abc import Callable

import click

from swarmabs_cli.bench import bench
from swarmabs_cli.check import check
from swarmabs_cli.compare import compare
from swarmabs_cli.deploy import deploy
from swarmabs_cli.environment import doctor, env
from swarmabs_cli.export import export
from swarmabs_cli.figures import figures
from swarmabs_cli.info import info
from swarmabs_cli.interrupts import interrupt_once
from swarmabs_cli.markers import markers
from swarmabs_cli.operate import drain, join, remove, reset, status, stop
from swarmabs_cli.repair import repair
from swarmabs_cli.replay import replay
from swarmabs_cli.report import report
from swarmabs_cli.run import run, simulate
from swarmabs_cli.scenario import scenario
from swarmabs_cli.steer import steer
from swarmabs_cli.sweep import sweep
from swarmabs_cli.test import test
from swarmabs_cli.top import top
from swarmabs_cli.verify import verify
from swarmabs_cli.view import view
from swarmabs_core.errors import InputError, SwarmabsError


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
def swarm() -> None:
    """Run swarms that balance a tilting plane, as one ROS 2 process per robot, and record them.

    Exit codes: 0 fine, 1 started and failed, 2 refused before anything was started.
    """


for command in (
    run,
    simulate,
    steer,
    check,
    info,
    verify,
    replay,
    repair,
    compare,
    report,
    view,
    export,
    markers,
    scenario,
    env,
    doctor,
    bench,
    sweep,
    figures,
    deploy,
    status,
    stop,
    reset,
    drain,
    join,
    remove,
    top,
    test,
):
    swarm.add_command(command)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line, by default that of this process, and return the exit code."""
    if arguments is None:
        interrupt_once()
    return exit_code(lambda: swarm.main(arguments, prog_name="swarm", standalone_mode=False))


def exit_code(command: Callable[[], int | None]) -> int:
    """Carry out a command and return its exit code; what it refuses, and why it failed, is printed."""
    try:
        code = command()
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else "swarm"
        click.echo(f"error: {error.format_message()} See {path} --help.", err=True)
        return error.exit_code
    except (click.exceptions.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        return 1
    except InputError as error:
        click.echo(f"error: {error}", err=True)
        return 2
    except SwarmabsError as error:
        click.echo(f"error: {error}", err=True)
        return 1
    return int(code or 0)
