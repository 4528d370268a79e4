"""``swarm test``."""

from __future__ import annotations

import os
import subprocess
import sys

import click

from swarmabs_cli.checkout import checkout

MOST_WORKERS = 4
"""Processes that share the tests which start none; each takes some 500 MB."""


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
    code = subprocess.run([sys.executable, "-m", *words], cwd=checkout(), check=False).returncode
    return 1 if code < 0 else code
