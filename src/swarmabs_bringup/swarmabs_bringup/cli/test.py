"""``swarm test``."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import click

from swarmabs_core.errors import InputError


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--full", is_flag=True, help="Also what takes long: storms, soaks, fuzzing.")
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def test(pytest_arguments: tuple[str, ...], *, full: bool) -> int:
    """Check the code and run the tests; arguments beyond --full go to pytest, and then only pytest runs."""
    root = _checkout()
    steps = [] if pytest_arguments else [["ruff", "check", "."], ["mypy"]]
    steps.append(["pytest", *(["--full"] if full else []), *pytest_arguments])
    for module, *arguments in steps:
        click.echo(f"== {module} {' '.join(arguments)}", err=True)
        code = subprocess.run([sys.executable, "-m", module, *arguments], cwd=root, check=False).returncode
        if code:
            return 1 if code < 0 else code
    return 0


def _checkout() -> Path:
    """Return the checkout in which, or from which, the command was started."""
    for start in (Path.cwd(), Path(sys.prefix)):
        for folder in (start, *start.parents):
            if (folder / "scripts" / "swarm").is_file() and (folder / "tests").is_dir():
                return folder
    raise InputError("no checkout of swarmabs found here; change into one")
