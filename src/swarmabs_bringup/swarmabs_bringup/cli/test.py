"""``swarm test``."""

from __future__ import annotations

import subprocess
import sys

import click

from swarmabs_bringup.checkout import checkout


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--full", is_flag=True, help="Also what takes long: storms, soaks, fuzzing.")
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def test(pytest_arguments: tuple[str, ...], *, full: bool) -> int:
    """Check the code and run the tests; arguments beyond --full go to pytest, and then only pytest runs."""
    root = checkout()
    steps = [] if pytest_arguments else [["ruff", "check", "."], ["mypy"]]
    steps.append(["pytest", *(["--full"] if full else []), *pytest_arguments])
    for module, *arguments in steps:
        click.echo(f"== {module} {' '.join(arguments)}", err=True)
        code = subprocess.run([sys.executable, "-m", module, *arguments], cwd=root, check=False).returncode
        if code:
            return 1 if code < 0 else code
    return 0
