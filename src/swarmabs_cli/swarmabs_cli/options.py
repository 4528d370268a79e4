"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypedDict, TypeVar

import click

from swarmabs_config.installation import COMMAND
from swarmabs_core.links import CENTRAL, EACH_ROBOT
from swarmabs_core.nodes import NodeName

RUNS = Path("runs")
"""Parent of the folders of results that are not named by -o."""
A_PATH = click.Path(path_type=Path)

_END_OF = {"[": "]", "{": "}"}


NumberT = TypeVar("NumberT", bound=float)


class _InWords(Generic[NumberT]):
    """A range of numbers that help and errors describe in words."""

    min: NumberT | None
    max: NumberT | None
    min_open: bool
    max_open: bool

    def _describe_range(self) -> str:
        low = "" if self.min is None else f"{'more than' if self.min_open else 'at least'} {self.min:.9g}"
        high = "" if self.max is None else f"{'less than' if self.max_open else 'at most'} {self.max:.9g}"
        if low and high and not (self.min_open or self.max_open):
            return f"{self.min:.9g} to {self.max:.9g}"
        return " and ".join(filter(None, (low, high)))

    def get_metavar(self, *_: object, **__: object) -> str:
        """Return what stands for the number in the help."""
        return "NUMBER"


class WholeNumber(_InWords[int], click.IntRange):
    """A whole number in a range."""

    name = "whole number"


class Number(_InWords[float], click.FloatRange):
    """A number in a range."""

    name = "number"


Decorator = Callable[[Callable[..., object]], Callable[..., object]]

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
    """Return the epilog of a command's help from example command lines, which get the prefix `COMMAND` if needed."""
    shown = (line if COMMAND in line else f"{COMMAND} {line}" for line in lines)
    return "\n".join(("\b", "Examples:", *(f"  {line}" for line in shown)))


def set_option(text: str = "Change a value of the scenario, such as plane.angle=0.2; repeatable.") -> Decorator:
    """Return the option ``--set`` that changes values."""
    return click.option("--set", "overrides", multiple=True, metavar="A.B=VALUE", help=text, callback=_check_quoted)


def _check_quoted(_context: click.Context, _option: click.Parameter, texts: tuple[str, ...]) -> tuple[str, ...]:
    """Reject a list or mapping without its end, which a shell splits off at a space that is not quoted."""
    for text in texts:
        path, _, value = text.partition("=")
        if (end := _END_OF.get(value[:1])) and not value.rstrip().endswith(end):
            raise click.BadParameter(
                f"{text!r} has no closing '{end}'; put a value with spaces in quotes: --set '{path}={value[0]}...{end}'"
            )
    return texts


def node_option(text: str) -> Decorator:
    """Return the option ``--node``, given to the command as the parameter `nodes`."""
    return click.option("--node", "nodes", multiple=True, metavar="NODE", help=text, callback=_nodes)


def _nodes(_context: click.Context, _option: click.Parameter, texts: tuple[str, ...]) -> tuple[NodeName, ...]:
    return tuple(map(NodeName.parse, dict.fromkeys(texts)))


def output_option(text: str, *, required: bool = False, metavar: str | None = None) -> Decorator:
    """Return the option ``-o`` for the place of results."""
    return click.option("-o", "--output", type=A_PATH, help=text, required=required, metavar=metavar)


def together(*decorators: Decorator) -> Decorator:
    """Return one decorator that adds several options in the given order."""

    def add(function: Callable[..., object]) -> Callable[..., object]:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return add


def _whole(unit: str, largest: int) -> Callable[[click.Context, click.Parameter, str], int]:
    """Return a parser of whole numbers from 0 on, as accepted by the same options of ``ros2 bag record``."""

    def read(_context: click.Context, _option: click.Parameter, text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = -1
        if not 0 <= number <= largest:
            raise click.BadParameter(
                f"{text!r} is not a whole number of {unit} (as with ros2 bag record); give 1 to {largest}, or 0 for a "
                "bag in one file."
            )
        return number

    return read


class RunParameters(TypedDict):
    """What `run_options` give to a command."""

    scenario: str
    bag_scenario: str | None
    output: Path | None
    overrides: tuple[str, ...]
    duration: str | None
    coordination: str | None
    no_bag: bool
    max_bag_size: int
    max_bag_duration: int
    as_json: bool


run_options = together(
    scenario_argument,
    named_scenario_option("bag_scenario"),
    output_option("Folder of the results.  [default: runs/NAME-NNN]"),
    set_option(),
    duration_option,
    click.option(
        "--coordination",
        type=click.Choice((CENTRAL, EACH_ROBOT)),
        help="Where the swarm is summed up and controlled; short for --set coordination=.",
    ),
    click.option("--no-bag", is_flag=True, help="Write no bag; the digest and the summary are still computed."),
    click.option(
        "--max-bag-size",
        default="0",
        callback=_whole("bytes", 2**63 - 1),
        metavar="BYTES",
        help="Start a new bag file at this size.  [default: never]",
    ),
    click.option(
        "--max-bag-duration",
        default="0",
        callback=_whole("seconds", 10**9),
        metavar="SECONDS",
        help="Start a new bag file after this simulated time.  [default: never]",
    ),
    json_option,
)
