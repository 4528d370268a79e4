"""``swarm bench``."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from swarmabs_cli.output import json_option, print_json

if TYPE_CHECKING:
    from collections.abc import Iterable

    from swarmabs_cli.bench_framework.tables import Table

RUNS = Path("runs")
WIDTH = 160
"""Of what is printed into a file or pipe, characters."""
SUITES = ("product", "start", "memory", "large", "simulate", "recorder", "reading")


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
@click.option("--robots", default="4,20,64,200", show_default=True, callback=_numbers, help="Numbers of robots.")
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
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Folder of the result.  [default: runs/bench-NNN]"
)
@json_option
def bench(
    suites: tuple[str, ...],
    robots: tuple[int, ...],
    repeat: int,
    window: float,
    starts: int | None,
    large: tuple[int, ...],
    agents_per_process: int,
    compare: tuple[Path, Path] | None,
    output: Path | None,
    *,
    busy: bool,
    as_json: bool,
) -> None:
    """Measure speed, start, memory, recording and reading, beside what DDS, ZeroMQ and the mcap library reach.

    The result is a folder with bench.json, bench.md and a chart; docs/performance.md says how to read it.
    """
    # All of these are slow to import, and not for --help.
    from swarmabs_bag.run_folder import new_run_folder, next_run_folder  # noqa: PLC0415
    from swarmabs_cli.bench_framework.results import read_result, write_result  # noqa: PLC0415
    from swarmabs_cli.bench_framework.suites import (  # noqa: PLC0415
        SUITES as ALL,
        Settings,
        check_prerequisites,
        run_suites,
    )
    from swarmabs_cli.bench_framework.tables import comparison, notes, tables  # noqa: PLC0415
    from swarmabs_run.interruption import terminable  # noqa: PLC0415

    if compare:
        table = comparison(*map(read_result, compare))
        if as_json:
            print_json([dict(zip(table.headings, row, strict=True)) for row in table.rows])
        else:
            _show((table,))
        return
    chosen = tuple(suite for suite in ALL if suite in suites or "all" in suites)
    settings = Settings(chosen, robots, repeat, window, min(2.0, window / 3.0), starts, busy, large, agents_per_process)
    check_prerequisites(settings)
    folder = new_run_folder(output) if output is not None else next_run_folder(RUNS, "bench")
    try:
        with terminable():
            document = run_suites(settings, lambda line: click.echo(line, err=True))
        write_result(document, folder.path)
    finally:
        with suppress(OSError):  # not empty: that is the result
            folder.path.rmdir()
    if as_json:
        print_json(document)
        return
    _show(tables(document))
    for note in notes(document):
        click.echo(note)
    click.echo(f"folder: {folder.path}")


def _show(shown: Iterable[Table]) -> None:
    """Print tables for people."""
    from rich.console import Console  # noqa: PLC0415 - slow to import
    from rich.table import Table as RichTable  # noqa: PLC0415

    console = Console(highlight=False, width=None if sys.stdout.isatty() else WIDTH)
    for table in shown:
        made = RichTable(box=None, header_style="dim")
        for heading in table.headings:
            made.add_column(heading)
        for row in table.rows:
            made.add_row(*row)
        console.print(f"{table.name}: {table.caption}", soft_wrap=True)
        console.print(made)
