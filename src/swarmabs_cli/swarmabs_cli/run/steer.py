"""``swarm steer``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from swarmabs_cli.options import examples, json_option, run_argument
from swarmabs_cli.output import print_json
from swarmabs_core.errors import InputError
from swarmabs_run.steering.client import SteeringClient

ACTIONS = ("reference", "disturbance", "kill", "freeze", "remove", "leave", "add", "status")


@click.command(
    context_settings={"ignore_unknown_options": True},  # a negative number is not an option
    epilog=examples("steer runs/pd_het_4-001 reference 0.05", "steer runs/pd_het_4-001 kill 2"),
)
@run_argument
@click.argument("action", type=click.Choice(ACTIONS))
@click.argument("value", required=False, metavar="[VALUE|ROBOT]")
@json_option
def steer(run: Path, action: str, value: str | None, *, as_json: bool) -> int:
    """Change a running simulation that was started with --steer.

    RUN is the folder of the run. `reference` offsets the reference (rad) and `disturbance` applies a torque to the
    plane (N m); both hold until you set them again. The other actions take the id of a robot; `leave` is the same as
    `remove`. `status` prints the current values. The answer names the first step that the change applies to.
    """
    request = {"action": action, **_argument(action, value)}
    with SteeringClient(run) as client:
        answer = client.ask(request)
    if as_json:
        print_json(answer)
    if not answer["ok"]:
        raise InputError(str(answer["reason"]))
    if not as_json:
        click.echo(
            _status(answer) if action == "status" else f"applies from step {answer['step']}, t = {answer['time']:g} s"
        )
    return 0


def _argument(action: str, value: str | None) -> dict[str, Any]:
    if action == "status":
        if value is not None:
            raise InputError(f"status takes no value; remove {value!r}")
        return {}
    of_robot = action not in ("reference", "disturbance")
    try:
        if of_robot:
            return {"agent": int(value or "")}
        return {"value": float(value or "")}
    except ValueError:
        wanted = "the id of a robot, e.g. 3" if of_robot else "a number, e.g. 0.1"
        found = "found none" if value is None else f"found {value!r}"
        raise InputError(f"{action}: expected {wanted}, {found}; give one") from None


def _status(answer: dict[str, Any]) -> str:
    def ids(name: str) -> str:
        return ", ".join(map(str, answer[name])) or "none"

    return "\n".join(
        (
            f"step {answer['step']} of {answer['steps']}, t = {answer['time']:g} s",
            f"reference {answer['reference']:+g} rad, at most {answer['largest_reference']:g}",
            f"disturbance {answer['disturbance']:+g} N m, at most {answer['largest_disturbance']:g}",
            f"active robots: {ids('members')}",
            f"robots that can be added: {ids('absent')}",
        )
    )
