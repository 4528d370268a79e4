"""Output that several commands share."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.console import RenderableType

_WIDEST = 1000
"""Of what is printed into a file or pipe, characters."""


def print_json(document: object) -> None:
    """Print exactly one JSON document to standard output."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))


def print_tables(*tables: RenderableType) -> None:
    """Print tables to standard output, in the width of the terminal; elsewhere in as much width as they need."""
    from rich.console import Console, Group  # noqa: PLC0415 - slow to import

    console, shown = Console(highlight=False), Group(*tables)
    if not console.is_terminal:
        console.width = console.measure(shown, options=console.options.update(max_width=_WIDEST)).maximum
    console.print(shown)


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
