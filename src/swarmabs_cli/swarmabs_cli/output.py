"""Output that several commands share."""

from __future__ import annotations

import html
import json
import webbrowser
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import click
from rich.console import Console, Group, RenderableType

from swarmabs_bag.run_folder import RunFolder, new_run_folder, next_run_folder
from swarmabs_cli.options import RUNS
from swarmabs_config.files import write_whole

if TYPE_CHECKING:
    from swarmabs_run.doctor import Finding

_WIDEST = 1000
"""Largest width of what is printed to a file or pipe, characters."""
_SIGNS = {"ok": "ok  ", "note": "note", "bad": "BAD "}


def print_json(document: object) -> None:
    """Print exactly one JSON document to standard output."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))


def print_documents(documents: Sequence[object]) -> None:
    """Print one JSON document as it is, several as a list."""
    print_json(documents[0] if len(documents) == 1 else documents)


def print_files(files: Sequence[Path], *, as_json: bool) -> None:
    """Print the paths of written files, a line each, or as a JSON document."""
    if as_json:
        print_json({"files": [str(path) for path in files]})
        return
    for path in files:
        click.echo(path)


def print_tables(*tables: RenderableType) -> None:
    """Print tables to standard output, in the width of the terminal; to a file or pipe as wide as needed."""
    console, shown = Console(highlight=False), Group(*tables)
    if not console.is_terminal:
        console.width = console.measure(shown, options=console.options.update(max_width=_WIDEST)).maximum
    console.print(shown, crop=False)


def print_warnings(warnings: Iterable[object]) -> None:
    """Print warnings to standard error."""
    for warning in warnings:
        click.echo(f"warning: {warning}", err=True)


def print_findings(findings: Sequence[Finding], *, as_json: bool) -> int:
    """Print the findings of checks; return the exit code, 1 if one of them is bad."""
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        for finding in findings:
            click.echo(f"{_SIGNS[finding.verdict]}  {finding.check}: {finding.text}")
    return 1 if any(finding.verdict == "bad" for finding in findings) else 0


def printable(line: str) -> str:
    """Replace unprintable characters of a line, so that text from a file cannot control the terminal."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in line)


def results_folder(output: Path | None, name: str) -> RunFolder:
    """Make the folder of results: the one that the user has named, or the next free one for a name."""
    return new_run_folder(output) if output is not None else next_run_folder(RUNS, name)


@contextmanager
def private_page(url: str) -> Iterator[str]:
    """Yield the address of a page that leads to another one, whose address thus is in no argument of a process.

    The page is a file that only this user can read, and is removed at the end.
    """
    with TemporaryDirectory(prefix="swarmabs-") as folder:
        page = Path(folder, "open.html")
        write_whole(page, f'<meta http-equiv="refresh" content="0; url={html.escape(url)}">\n'.encode(), mode=0o600)
        yield page.as_uri()


def open_page(url: str) -> None:
    """Open a page in the user's browser, if there is one."""
    if not webbrowser.open(url):
        click.echo("warning: no browser could be started; open the address yourself", err=True)
