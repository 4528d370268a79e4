"""The commands that operate a swarm in real time: `swarm stop`, `reset`, `failover`, `drain`, `join`, and others."""

from __future__ import annotations

import os
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import inf
from pathlib import Path
from select import select

import click
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from swarmabs_cli.options import Number, examples, json_option, together
from swarmabs_cli.output import print_json, print_warnings
from swarmabs_config.graph import OBSERVER
from swarmabs_core.errors import RunError
from swarmabs_core.hearing import Hearing
from swarmabs_core.realtime.observer import Role
from swarmabs_core.realtime.peer import SWARM
from swarmabs_fleet import pairs
from swarmabs_fleet.operate import (
    SILENT,
    HealthMonitor,
    OperatorClient,
    RobotWatch,
    Row,
    StopMonitor,
    Target,
    in_order,
    joined,
    target,
)

_STYLES = {"OK": "green", "WARN": "yellow"}

_swarm = click.argument("swarm", metavar="FLEET.yaml|RUN", type=click.Path(exists=True, path_type=Path))
_robot = click.argument("robot", type=int)
_timeout = click.option(
    "--timeout",
    "patience",
    type=Number(0.1, 600.0),
    default=5.0,
    show_default=True,
    metavar="SECONDS",
    help="Time limit for discovery, and for each answer.",
)
of_swarm, of_robot = together(_swarm, _timeout), together(_swarm, _robot, _timeout)


@click.command(epilog=examples("stop runs/pd_het_4-001", "stop examples/fleet/lan.yaml --armed"))
@of_swarm
@click.option("--armed", is_flag=True, help="Connect now, and stop the robots when you press a key.")
@json_option
def stop(swarm: Path, patience: float, *, armed: bool, as_json: bool) -> None:
    """Stop all robots of a fleet or a real-time run until `reset`, and report which have stopped.

    Robots confirm by their states that they are in their safe stop. The exit code is 1 if one is not known to have
    stopped. Starting and connecting take longer than stopping: keep a terminal with --armed open while robots move.
    """
    with target(swarm) as operated, joined(operated) as client:
        watch = client.watch()
        if armed:
            _wait_for_key(operated, client, watch, patience, quiet=as_json)
        watch.ask()
        warnings = pairs.stop(operated, client, patience)
        watch.confirm()
        watch.listen(patience, lambda: not watch.monitor.problems())
        _print_stop(operated, watch.monitor, as_json=as_json)
        print_warnings(warnings)
    if problems := watch.monitor.problems():
        unknown = ", ".join(map(str, problems))
        raise RunError(
            f"{operated.name}: {len(problems)} of {len(operated.robots)} robots are not known to have stopped: "
            f"{unknown}; check them, and stop them by hand if they move"
        )


def _print_stop(operated: Target, monitor: StopMonitor, *, as_json: bool) -> None:
    """Print which robots have stopped, before leaving the network, which takes longer."""
    problems = monitor.problems()
    if as_json:
        robots = [
            {"robot": robot, "stopped_after": None, "problem": problems[robot]}
            if robot in problems
            else {"robot": robot, "stopped_after": monitor.delay(robot), "problem": None}
            for robot in operated.robots
        ]
        print_json({"swarm": operated.name, "all_stopped": not problems, "robots": robots})
        return
    for robot in operated.robots:
        click.echo(f"robot {robot}: {problems.get(robot) or f'stopped after {1e3 * monitor.delay(robot):.0f} ms'}")
    if not problems:
        click.echo(f"{operated.name}: all robots have stopped, until a reset")


def _wait_for_key(operated: Target, client: OperatorClient, watch: RobotWatch, patience: float, *, quiet: bool) -> None:
    """Connect to controller and robots, then wait for a key; if `quiet`, the prompt is not on standard output.

    Raises
    ------
    RunError
        If no controller is found, or no key can be pressed because standard input ends.
    """
    robots = len(operated.robots)
    watch.listen(patience, lambda: pairs.can_stop(operated, client) and watch.monitor.heard() == robots)
    if not pairs.can_stop(operated, client):
        raise RunError(
            f"{operated.name}: nobody was found who can be told to stop; check that the controller, or the robots, run"
        )
    click.echo(
        f"{operated.name}: armed, {watch.monitor.heard()} of {robots} robots heard; press a key to stop them", err=quiet
    )
    with _single_keys() as pressed:
        watch.listen(inf, pressed)


@contextmanager
def _single_keys() -> Iterator[Callable[[], bool]]:
    """Let a terminal pass each key on at once; yield a function that tells whether one was pressed."""

    def pressed() -> bool:
        if not select([sys.stdin], [], [], 0.0)[0]:
            return False
        if not os.read(sys.stdin.fileno(), 1):
            raise RunError("standard input has ended, so no key can be pressed; run this in a terminal")
        return True

    before = termios.tcgetattr(sys.stdin) if sys.stdin.isatty() else None
    try:
        if before is not None:
            tty.setcbreak(sys.stdin)
        yield pressed
    finally:
        if before is not None:
            termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, before)


@click.command(epilog=examples("reset runs/pd_het_4-001"))
@of_swarm
def reset(swarm: Path, patience: float) -> None:
    """Let the robots move again after a stop.

    A fleet that starts in the stopped state moves after its first `reset`.
    """
    with target(swarm) as operated, joined(operated) as client:
        print_warnings(pairs.reset(operated, client, patience))
    click.echo(f"{operated.name}: robots stand still for one second, then follow the controller again")


@click.command(epilog=examples("failover examples/fleet/standby.yaml controller"))
@_swarm
@click.argument("coordinator", required=False, type=click.Choice(list(pairs.PAIRS)))
@_timeout
@json_option
def failover(swarm: Path, coordinator: str | None, patience: float, *, as_json: bool) -> None:
    """Let a standby coordinator take over, for example to service the host of the one that leads.

    Without COORDINATOR, each pair changes roles. The robots keep moving.
    """
    with target(swarm) as operated:
        kinds = pairs.chosen(operated, coordinator)
        leaders = []
        with joined(operated) as client:
            for kind in kinds:
                leader = pairs.failover(operated, client, kind, patience)
                leaders.append({"coordinator": kind, "leader": leader, "host": operated.hosts[leader]})
                if not as_json:
                    click.echo(f"{operated.name}: {leader} leads, on {operated.hosts[leader]}")
        if as_json:
            print_json({"swarm": operated.name, "leaders": leaders})


@click.command(epilog=examples("drain runs/pd_het_4-001 2"))
@of_robot
def drain(swarm: Path, robot: int, patience: float) -> None:
    """Take one robot out of service, for example to charge it.

    The robot stops; the observer no longer counts its weight as on the plane.
    """
    done = f"robot {robot} has stopped and counts as off the plane"
    _call(swarm, lambda operated: f"{operated.robot(robot)}/leave", patience, done)


@click.command(epilog=examples("join runs/pd_het_4-001 2"))
@of_robot
def join(swarm: Path, robot: int, patience: float) -> None:
    """Return a drained robot to service."""
    _call(swarm, lambda operated: f"{operated.robot(robot)}/join", patience, f"robot {robot} takes part again")


def _call(swarm: Path, service: Callable[[Target], str], patience: float, done: str) -> None:
    """Call a service of a node of the swarm, and print the effect."""
    with target(swarm) as operated:
        name = service(operated)
        with joined(operated) as client:
            client.call(name, patience)
    click.echo(f"{operated.name}: {done}")


@click.command(epilog=examples("remove runs/pd_het_4-001 2"))
@of_robot
def remove(swarm: Path, robot: int, patience: float) -> None:
    """Tell the swarm that a silent robot was removed.

    The observer then no longer counts its weight as on the plane; of a pair, the one that leads must confirm it, and
    any of robots that sum up the swarm by themselves. For a robot that is not silent, use `drain`.
    """
    with target(swarm) as operated:
        operated.robot(robot)
        alone = operated.decentralised
        observers = tuple(map(operated.robot, operated.robots)) if alone else operated.pair(OBSERVER)
        monitor = HealthMonitor({node: operated.hosts[node] for node in observers})

        def gone() -> bool:
            single = alone or len(observers) == 1
            leaders = [node for node in observers if single or pairs.leads(monitor, node)]
            left = f"{SWARM}{Role.LEFT.value}" if alone else Role.LEFT.value
            return any(str(robot) in monitor.value(node, left).split() for node in leaders)

        with joined(operated) as client, client.carried_away(robot, patience):
            client.listen(monitor, patience, gone)
    if not gone():
        raise RunError(
            f"{operated.name}: the observer has not removed robot {robot}, because only a silent robot can be removed; "
            f"use drain {robot} for one that is running"
        )
    click.echo(f"{operated.name}: robot {robot} counts as off the plane")


@click.command(epilog=examples("status runs/pd_het_4-001", "status examples/fleet/lan.yaml --watch"))
@_swarm
@click.option("--watch", is_flag=True, help="Update until Ctrl-C.")
@_timeout
@json_option
def status(swarm: Path, patience: float, *, watch: bool, as_json: bool) -> int:
    """Show the health of every node of a fleet or a real-time run.

    Of coordinators with a standby it shows which one leads, and since when, and of robots that sum up the swarm by
    themselves whom they hear and how old the states are that they use. It warns about certificates that expire
    within 30 days. The exit code is 1 if a node is silent or reports an error.
    """
    if watch and as_json:
        raise click.UsageError("--watch cannot be combined with --json; remove one of them")
    with target(swarm) as operated, joined(operated) as client:
        monitor = HealthMonitor(operated.hosts)
        print_warnings(operated.warnings)
        if watch:
            with Live(_table(operated, monitor.rows(0.0)), refresh_per_second=2) as live:

                def refresh() -> bool:
                    live.update(_table(operated, monitor.rows(time.monotonic())))
                    return False

                client.listen(monitor, float("inf"), refresh)
        client.listen(monitor, patience, monitor.complete)
        rows = monitor.rows(time.monotonic())
    if as_json:
        nodes = [row._asdict() for row in rows]
        print_json({"swarm": operated.name, "in_order": in_order(rows), "nodes": nodes, "warnings": operated.warnings})
    else:
        Console(highlight=False).print(_table(operated, rows))
    return 0 if in_order(rows) else 1


def _table(operated: Target, rows: Sequence[Row]) -> Table:
    table = Table(box=None, pad_edge=False)
    roles = pairs.has_standbys(operated)
    links = operated.decentralised
    for head in ("node", "host", "health", *(["role"] * roles), *(["links"] * links), "message"):
        table.add_column(head, overflow="fold")
    for row in rows:
        level = Text(row.level, style=_STYLES.get(row.level, "red"))
        role = [Text("" if row.level == SILENT else pairs.role(row.values))] * roles
        hearing = None if row.level == SILENT else Hearing.read(row.values)
        hears = [Text(hearing.words() if hearing else "")] * links
        table.add_row(Text(row.node), Text(row.host), level, *role, *hears, Text(row.text))
    return table
