"""``swarm env`` and ``swarm doctor``: the environment of ROS tools, and checks of this machine."""

from __future__ import annotations

import os
import shlex
from importlib.util import find_spec
from pathlib import Path

import click

from swarmabs_cli.options import examples, json_option
from swarmabs_cli.output import print_findings, print_json
from swarmabs_config.installation import COMMAND, lacking
from swarmabs_run.doctor import examine
from swarmabs_run.orchestration.run_files import environment_of_run

WORKSPACE = (
    "PATH",
    "LD_LIBRARY_PATH",
    "PYTHONPATH",
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "ROS_DISTRO",
    "ROS_VERSION",
    "ROS_PYTHON_VERSION",
    "RMW_IMPLEMENTATION",
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
)
"""The variables by which a shell finds this workspace."""
SOURCED = "SWARMABS_SOURCED_"
"""Prefix of the variables by which ``scripts/swarm`` adds this workspace to a ROS that was sourced."""


@click.command(epilog=examples('eval "$(./scripts/swarm env runs/pd_het_4-001)"'))
@click.argument("run", required=False, type=click.Path(path_type=Path))
@json_option
def env(run: Path | None, *, as_json: bool) -> None:
    """Print the environment variables for ROS tools.

    With RUN, the folder of a running simulation, the variables also select the network of that run. If you have sourced
    a ROS installation, its tools stay usable: the workspace is only added to it. Without RUN, the variables are those
    with which nodes start by hand; a sourced ROS is then left out, unless SWARMABS_USE_SOURCED_ROS=1.
    """
    if find_spec("rclpy") is None:
        raise lacking(ModuleNotFoundError(name="rclpy"), f"{COMMAND} env")
    variables = {name: os.environ[name] for name in WORKSPACE if name in os.environ}
    sourced = {name[len(SOURCED) :]: value for name, value in os.environ.items() if name.startswith(SOURCED)}
    if run is not None:
        variables = (sourced or variables) | environment_of_run(run)
    elif sourced:
        note = "the ROS that you have sourced is left out, because nodes run on the packages in .venv"
        click.echo(f"note: {note}; to keep it, run SWARMABS_USE_SOURCED_ROS=1 ./scripts/swarm env", err=True)
    if as_json:
        print_json(variables)
        return
    for name, value in variables.items():
        click.echo(f"export {name}={shlex.quote(value)}")


@click.command(epilog=examples("doctor"))
@json_option
def doctor(*, as_json: bool) -> int:
    """Check whether this machine can run swarms.

    Each finding that needs action says what to do.
    """
    return print_findings(examine(), as_json=as_json)
