"""Output that several commands share."""

from __future__ import annotations

import json

import click


def print_json(document: object) -> None:
    """Print exactly one JSON document to standard output."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document and nothing else.")
