"""The command line ``swarm``. It parses, calls the library and prints; it decides nothing.

Each command is a function of the same name, in a file in the folder of its section.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path

import click

from swarmabs_cli.options import examples
from swarmabs_core.errors import InputError, SwarmabsError
from swarmabs_run.ending import interrupt_once
from swarmabs_run.tracing_files import tracing_files_removed

SECTIONS = {
    "run": "Run swarms",
    "bags": "Work with bags",
    "study": "Study scenarios",
    "fleet": "Deploy and operate fleets",
    "develop": "Set up and develop",
}
"""Folders of commands, in the order in which they are listed, and their titles."""
_COMMAND = re.compile(r"^@click\.(?:command|group)\b.*?^def (\w+)\(", re.MULTILINE | re.DOTALL)


class LazyGroup(click.Group):
    """Commands that are loaded when they are called: what some of them need takes a second to load."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - given by click
        """Return the names of all commands, section by section."""
        return [name for section in SECTIONS for name in _files(section)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load a command; None if there is none of this name."""
        for section in SECTIONS:
            if file := _files(section).get(cmd_name):
                if not ctx.resilient_parsing:
                    ctx.with_resource(tracing_files_removed())
                command: click.Command = getattr(import_module(f"{__name__}.{section}.{file.stem}"), cmd_name)
                return command
        return None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """List the commands by section, without loading them."""
        for section, title in SECTIONS.items():
            files = _files(section)
            width = formatter.width - 6 - max(map(len, files))
            with formatter.section(title):
                formatter.write_dl([(name, _summary(name, path, width)) for name, path in files.items()])


@cache
def _files(section: str) -> dict[str, Path]:
    """Return the files of a section by the names of the commands in them."""
    files = (Path(__file__).parent / section).glob("[!_]*.py")
    found = {name: path for path in files for name in _COMMAND.findall(path.read_text(encoding="utf-8"))}
    return dict(sorted(found.items()))


def _summary(name: str, path: Path, width: int) -> str:
    """Read in its source how a command is described."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return click.Command(name, help=ast.get_docstring(node)).get_short_help_str(width)
    raise ValueError(f"{path}: no function {name}")


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog=examples("run", "view runs/pd_het_4-001", "run --help"),
)
@click.version_option(package_name=__name__, message="%(prog)s %(version)s")
def swarm() -> None:
    """Run, record and study swarms of robots that level a tilting plane, with one ROS 2 process per robot.

    Exit codes: 0 success, 1 started and failed, 2 refused before anything started.
    """


def main(arguments: list[str] | None = None) -> int:
    """Run the command line, by default that of this process, and return the exit code."""
    if arguments is None:
        interrupt_once()
    return exit_code(lambda: swarm.main(arguments, prog_name="swarm", standalone_mode=False))


def exit_code(command: Callable[[], int | None]) -> int:
    """Carry out a command and return its exit code; what it refuses, and why it failed, is printed."""
    try:
        code = command()
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else "swarm"
        click.echo(f"error: {error.format_message()} See {path} --help.", err=True)
        return error.exit_code
    except (click.exceptions.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        return 1
    except InputError as error:
        click.echo(f"error: {error}", err=True)
        return 2
    except SwarmabsError as error:
        click.echo(f"error: {error}", err=True)
        return 1
    return int(code or 0)
