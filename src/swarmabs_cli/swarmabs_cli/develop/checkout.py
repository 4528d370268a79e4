"""``swarm bench`` and ``swarm test``, which need more of the checkout than what is installed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import click

from swarmabs_cli.options import json_option, output_option
from swarmabs_core.errors import InputError

SUITES = ("product", "start", "memory", "large", "simulate", "recorder", "reading")
_LONGEST_WARM_UP = 2.0
"""Time before a measurement that does not count, s; at most a third of its length."""

MOST_WORKERS = 4
"""Processes that share the tests which start none; each takes some 500 MB."""


def _numbers(_context: click.Context, _option: click.Parameter, text: str) -> tuple[int, ...]:
    """Read numbers of robots."""
    try:
        numbers = tuple(int(word) for word in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list such as 4,20") from None
    if min(numbers) < 2:
        raise click.BadParameter(f"{min(numbers)} is too few; a swarm has at least 2 robots")
    return numbers


@click.command()
@click.option(
    "--suite",
    "suites",
    type=click.Choice((*SUITES, "all")),
    multiple=True,
    default=("all",),
    show_default=True,
    help="What to measure; repeatable.",
)
@click.option(
    "--robots",
    default="4,20,64,200",
    show_default=True,
    callback=_numbers,
    metavar="N,N",
    help="Numbers of robots.",
)
@click.option("--repeat", type=click.IntRange(1), default=3, show_default=True, help="How often to measure everything.")
@click.option(
    "--window",
    type=click.FloatRange(0.1),
    default=6.0,
    show_default=True,
    metavar="SECONDS",
    help="Length of a measurement.",
)
@click.option(
    "--starts",
    type=click.IntRange(1),
    metavar="N",
    help="How often to start and end a run in the suites start and memory.  [default: as --repeat]",
)
@click.option("--busy", is_flag=True, help="Keep all cores busy with other processes during these starts.")
@click.option(
    "--large",
    default="200,500,1000,2000",
    show_default=True,
    callback=_numbers,
    metavar="N,N",
    help="Numbers of robots in the suite large.",
)
@click.option(
    "--agents-per-process",
    type=click.IntRange(1),
    default=50,
    show_default=True,
    help="Robots that share a process in the suite large.",
)
@click.option(
    "--compare",
    nargs=2,
    type=click.Path(path_type=Path),
    metavar="OLD NEW",
    help="Measure nothing; compare two results, each a folder or its bench.json.",
)
@output_option("Folder of the result.  [default: runs/bench-NNN]")
@json_option
def bench(
    suites: tuple[str, ...],
    window: float,
    compare: tuple[Path, Path] | None,
    output: Path | None,
    *,
    as_json: bool,
    **settings: object,
) -> None:
    """Measure speed, start, memory, recording and reading, beside what DDS, ZeroMQ and the mcap library reach.

    The result is a folder with bench.json, bench.md and a chart; docs/performance.md says how to read it.
    """
    chosen = [suite for suite in SUITES if suite in suites or "all" in suites]
    settings |= {"suites": chosen, "window": window, "warm_up": min(_LONGEST_WARM_UP, window / 3.0)}
    asked = {"settings": settings, "compare": compare, "output": output, "as_json": as_json}
    search = os.pathsep.join(filter(None, (str(_checkout()), os.environ.get("PYTHONPATH"))))
    command = [sys.executable, "-m", "benchmarks.bench", json.dumps(asked, default=str)]
    os.execve(sys.executable, command, os.environ | {"PYTHONPATH": search})  # noqa: S606 - no shell is wanted


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--full", is_flag=True, help="Also what takes long: storms, soaks, fuzzing.")
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def test(pytest_arguments: tuple[str, ...], *, full: bool) -> int:
    """Check the code and run the tests; arguments beyond --full go to pytest, and then only pytest runs."""
    pytest = ["pytest", *(["--full"] if full else [])]
    if pytest_arguments:
        return _run([*pytest, *pytest_arguments])
    for check in (["ruff", "check", "."], ["mypy"]):
        code = _run(check)
        if code:
            return code
    workers = str(min(MOST_WORKERS, os.cpu_count() or 1))
    first = _run([*pytest, "-m", "not system", "-n", workers, "--dist", "loadfile"])
    # Swarms of processes have the cores for themselves. Other programs of the machine may still take them away, so what
    # fails runs once more; that is printed.
    second = _run([*pytest, "-m", "system", "--reruns", "1", "-raR"])
    return first or second


def _run(words: list[str]) -> int:
    """Run a Python module with arguments; return its exit code."""
    click.echo(f"== {' '.join(words)}", err=True)
    code = subprocess.run([sys.executable, "-m", *words], cwd=_checkout(), check=False).returncode
    return 1 if code < 0 else code


def _checkout() -> Path:
    """Return the checkout in which, or from which, the command was started."""
    for start in (Path.cwd(), Path(sys.prefix)):
        for folder in (start, *start.parents):
            if (folder / "scripts" / "swarm").is_file() and (folder / "tests").is_dir():
                return folder
    raise InputError("no checkout of swarmabs found here; change into one")
