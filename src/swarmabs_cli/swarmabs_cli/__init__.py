"""The command line ``swarm``. It parses, calls the library and prints; it decides nothing.

Each command is a function of the same name, in a file in the folder of its section.
"""

from __future__ import annotations

import ast
import os
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from pathlib import Path

import click

from swarmabs_cli.options import examples
from swarmabs_config.installation import COMMAND, DISTRIBUTION, IS_WHEEL, lacking
from swarmabs_core.errors import InputError, SwarmabsError
from swarmabs_run.ending import interrupt_once, no_more_interrupts
from swarmabs_run.tracing_files import tracing_files_removed

SECTIONS = {
    "run": "Run swarms",
    "bags": "Work with bags",
    "study": "Study scenarios",
    "fleet": "Deploy and operate fleets",
    "develop": "Set up and develop",
}
"""Folders of commands, in the order in which they are listed, and their titles."""
EXAMPLE = "simulate" if IS_WHEEL else "run"
"""The command of the examples in the help."""
PARSE_ONLY = "SWARMABS_PARSE_ONLY"
"""Environment variable with which ``scripts/swarm`` asks whether a command line is right, before it installs for it."""
_COMMAND = re.compile(r"^@click\.(?:command|group)\b.*?^def (\w+)\(", re.MULTILINE | re.DOTALL)


class LazyGroup(click.Group):
    """Loads a command only when it is called, because some need modules that take a second to import."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - given by click
        """Return the names of all commands, section by section."""
        return [name for section in SECTIONS for name in _files(section)]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load a command; None if there is none of this name."""
        for section in SECTIONS:
            if file := _files(section).get(cmd_name):
                if not ctx.resilient_parsing:
                    ctx.with_resource(tracing_files_removed())
                try:
                    module = import_module(f"{__name__}.{section}.{file.stem}")
                except ModuleNotFoundError as error:
                    raise lacking(error, f"{COMMAND} {cmd_name}") from None
                command: click.Command = getattr(module, cmd_name)
                return command
        return None

    def invoke(self, ctx: click.Context) -> object:
        """Run a command; the error tells what it needs that is not installed."""
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            raise lacking(error, f"{COMMAND} {ctx.invoked_subcommand}") from None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; the error for an unknown one suggests those with similar names."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = get_close_matches(args[0], self.list_commands(ctx), n=1)
            hint = f"did you mean '{near[0]}'?" if near else "--help lists the commands"
            raise click.UsageError(f"no command {args[0]!r}; {hint}", ctx) from error

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """List the commands by section, without loading them."""
        for section, title in SECTIONS.items():
            files = _files(section)
            with formatter.section(title):
                formatter.write_dl([(name, _summary(name, path)) for name, path in files.items()])


@cache
def _files(section: str) -> dict[str, Path]:
    """Return the files of a section by the names of the commands in them."""
    files = (Path(__file__).parent / section).glob("[!_]*.py")
    commands = {name: path for path in files for name in _COMMAND.findall(path.read_text(encoding="utf-8"))}
    return dict(sorted(commands.items()))


def _summary(name: str, path: Path) -> str:
    """Return the first sentence of the help of a command, read from its source."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return " ".join((ast.get_docstring(node) or "").partition("\n\n")[0].split())
    raise ValueError(f"{path}: no function {name}")


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog=examples(EXAMPLE, "view runs/pd_het_4-001", f"{EXAMPLE} --help"),
)
@click.version_option(package_name=DISTRIBUTION, message="swarm %(version)s")
def swarm() -> None:
    """Run, record and study swarms of robots that level a tilting plane, with one ROS 2 process per robot.

    Exit codes: 0 success, 1 started and failed, 2 rejected before anything started.
    """


def main(arguments: list[str] | None = None) -> int:
    """Run the command line, by default that of this process, and return the exit code."""

    def command() -> int | None:
        if arguments is None:
            interrupt_once()
        if os.environ.get(PARSE_ONLY):
            return parsed(sys.argv[1:] if arguments is None else arguments)
        code: int | None = swarm.main(arguments, prog_name=COMMAND, standalone_mode=False)
        return code

    code = exit_code(command)
    no_more_interrupts()
    return code


def parsed(arguments: list[str]) -> int:
    """Parse a command line without carrying it out; raises what carrying it out would raise because of its words."""
    with click.Context(swarm, info_name=COMMAND) as context, suppress(click.exceptions.Exit):  # help is right
        name, command, rest = swarm.resolve_command(context, [*arguments])
        if command is not None:
            command.make_context(name, rest, parent=context).close()
    return 0


def _sentence(text: str) -> str:
    """Return an error of click as a sentence in plain words, with the remedy that click leaves out."""
    text = text.replace("a valid number", "a number").replace("a valid whole number", "a whole number")
    text = text.replace(" is not in the range ", " is out of range: give ")
    if text.startswith("Got unexpected extra argument"):
        text = f"{text.rstrip('.')}; remove it, or put the value that it belongs to in quotes"
    return text if text.endswith((".", "?")) else f"{text}."


def exit_code(command: Callable[[], int | None]) -> int:
    """Run a command and return its exit code; errors are printed."""
    try:
        code = command()
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return error.exit_code
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        path = context.command_path if context is not None else COMMAND
        click.echo(f"error: {_sentence(error.format_message())} See {path} --help.", err=True)
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
