"""``swarm steer``."""

from __future__ import annotations

from pathlib import Path

import click

from swarmabs_cli.options import examples, json_option, run_argument
from swarmabs_cli.output import print_json
from swarmabs_core.errors import InputError
from swarmabs_run.steering.client import Answer, SteeringClient

NUMBERS = ("reference", "disturbance", "push")
BARE = ("pause", "resume", "restart", "restart_beside", "status")
ACTIONS = (*NUMBERS, "kill", "freeze", "remove", "leave", "add", *BARE)


@click.command(
    context_settings={"ignore_unknown_options": True},  # a negative number is not an option
    epilog=examples(
        "steer runs/pd_het_4-001 reference 0.05",
        "steer runs/pd_het_4-001 push -2",
        "steer runs/pd_het_4-001 kill 2",
        "steer runs/pd_het_4-001 pause",
    ),
)
@run_argument
@click.argument("action", type=click.Choice(ACTIONS), metavar="ACTION")
@click.argument("value", required=False, metavar="[VALUE|ROBOT]")
@json_option
def steer(run: Path, action: str, value: str | None, *, as_json: bool) -> int:
    """Change a running simulation that was started with --steer.

    RUN is the folder of the run. `reference` offsets the reference (rad) and `disturbance` applies a torque to the
    plane (N m); both hold until you set them again. `push` adds a torque for 0.2 s. `kill`, `freeze`, `remove` and
    `add` take the id of a robot; `leave` is the same as `remove`. `pause` holds the run until `resume`. `restart` ends
    a run of `demo`, which starts again, and `restart_beside` with the robots beside the curve of desired states.
    `status` prints the current values. The answer names the first step that the change applies to.
    """
    request = {"action": action, **_argument(action, value)}
    with SteeringClient(run) as client:
        answer = client.ask(request)
    if as_json:
        print_json(answer)
    if not answer["ok"]:
        raise InputError(str(answer["reason"]))
    if not as_json:
        click.echo(_status(answer) if action == "status" else _told(action, answer))
    return 0


def _argument(action: str, value: str | None) -> dict[str, float]:
    if action in BARE:
        if value is not None:
            raise InputError(f"{action} takes no value; remove {value!r}")
        return {}
    of_robot = action not in NUMBERS
    try:
        if of_robot:
            return {"agent": int(value or "")}
        return {"value": float(value or "")}
    except ValueError:
        wanted = "the id of a robot, e.g. 3" if of_robot else "a number, e.g. 0.1"
        given = "none" if value is None else repr(value)
        raise InputError(f"{action}: expected {wanted}, found {given}; give one") from None


def _told(action: str, answer: Answer) -> str:
    if action in BARE:
        done = {"pause": "paused", "resume": "resumed"}.get(action, "ends, to start again")
        return f"{done} at step {answer['step']}, t = {answer['time']:g} s"
    return f"applies from step {answer['step']}, t = {answer['time']:g} s"


def _status(answer: Answer) -> str:
    def ids(name: str) -> str:
        return ", ".join(map(str, answer[name])) or "none"

    return "\n".join(
        (
            f"step {answer['step']} of {answer['steps']}, t = {answer['time']:g} s" + ", paused" * answer["paused"],
            f"reference {answer['reference']:+g} rad, at most {answer['largest_reference']:g}",
            f"disturbance {answer['disturbance']:+g} N m, at most {answer['largest_disturbance']:g}",
            f"active robots: {ids('members')}",
            f"robots that can be added: {ids('absent')}",
        )
    )
