"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

RUNS = Path("runs")
"""Where the folders of results are that are not named."""
A_PATH = click.Path(path_type=Path)

COMMAND = "./scripts/swarm"
"""How users start the command line."""

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
namespace_option = click.option("--namespace", metavar="NAME", help="Swarm to read if the bag holds several.")
bag_argument = click.argument("bag", type=A_PATH, metavar="BAG")
bags_argument = click.argument("bags", nargs=-1, required=True, type=A_PATH, metavar="BAG...")
run_argument = click.argument("run", type=A_PATH, metavar="RUN")
scenario_argument = click.argument("scenario", default="pd_het_4", metavar="[SCENARIO|FILE.yaml|BAG]")
duration_option = click.option(
    "--duration", metavar="SECONDS", help="Simulated time; short for --set duration=SECONDS."
)


def named_scenario_option(parameter: str = "scenario") -> Decorator:
    """Return the option that names the scenario of a bag, given to the command as this parameter."""
    said = "Scenario of a bag that holds none, as ros2 bag record and convert write it."
    return click.option("--scenario", parameter, metavar="FILE", help=said)


def examples(*lines: str) -> str:
    """Return the end of a command's help: command lines, without how users start them where that comes first."""
    shown = (line if COMMAND in line else f"{COMMAND} {line}" for line in lines)
    return "\n".join(("\b", "Examples:", *(f"  {line}" for line in shown)))


def set_option(text: str = "Change a value of the scenario; repeatable.") -> Decorator:
    """Return the option ``--set`` that changes values."""
    return click.option("--set", "overrides", multiple=True, metavar="A.B=VALUE", help=text)


def output_option(text: str, **settings: Any) -> Decorator:
    """Return the option ``-o`` that says where results go."""
    return click.option("-o", "--output", type=A_PATH, help=text, **settings)


def together(*decorators: Decorator) -> Decorator:
    """Return one decorator that adds options in the order in which these are given."""

    def add(function: Callable[..., Any]) -> Callable[..., Any]:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return add
