"""Commands and options that the documentation names exist, and those that exist are named."""

from __future__ import annotations

import re
import shlex
from typing import TYPE_CHECKING

import click
import pytest
from tests.docs.pages import NAMES, blocks, read, rows, section, spans

from swarmabs_cli import swarm

if TYPE_CHECKING:
    from collections.abc import Iterator


def commands(group: click.Group = swarm, prefix: str = "") -> Iterator[tuple[str, click.Command]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from commands(command, f"{prefix}{name} ")
        else:
            yield f"{prefix}{name}", command


COMMANDS = dict(commands())


def options(command: click.Command) -> set[str]:
    found = {o for p in command.params if isinstance(p, click.Option) for o in (*p.opts, *p.secondary_opts)}
    return found - {"-h", "--help"}


def invocations(text: str) -> Iterator[list[str]]:
    """Return the words that follow ./scripts/swarm, wherever it stands as code."""
    lines = [line for language in ("sh", "text", "") for block in blocks(text, language) for line in block.splitlines()]
    for line in [*lines, *spans(text)]:
        for found in re.findall(r"\./scripts/swarm((?: [^)#&;|]*)?)", line):
            yield shlex.split(found.replace('"', ""))


@pytest.mark.parametrize("name", NAMES)
def test_invocations_exist(name: str) -> None:
    for words in invocations(read(name)):
        if not words:
            continue
        command = next((" ".join(words[:n]) for n in (2, 1) if " ".join(words[:n]) in COMMANDS), None)
        assert command, f"no command: swarm {' '.join(words)}"
        for word in words:
            if word.startswith("-"):
                assert word in options(COMMANDS[command]), f"no option: swarm {' '.join(words)}"


def test_invocations_are_found() -> None:
    assert ["run"] in invocations(read("README.md"))
    assert ["scenario", "list"] in invocations(read("docs/troubleshooting.md"))


def test_contract_names_every_command_with_its_options() -> None:
    described = {}
    for name, arguments in rows(section(read("docs/design.md"), "Command line")):
        described[name.strip("`")] = set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", arguments))
    assert described == {name: options(command) for name, command in COMMANDS.items()}


def test_readme_names_every_command() -> None:
    cells = [row[0] for row in rows(section(read("README.md"), "Commands"))]
    named = {
        re.sub(r" \[?(--)?[A-Z.\-a-z]*(SCENARIO|BAG|RUN|SWEEP|FLEET|full)[\].]*.*", "", text)
        for text in spans("\n".join(cells))
    }
    assert named == set(COMMANDS)


@pytest.mark.parametrize("option", ["-o", "--set", "--duration", "--no-bag"])
def test_readme_describes_options_of_runs(option: str) -> None:
    assert any(span.split()[0] == option for span in spans(section(read("README.md"), "Commands")))
    for name in ("run", "simulate"):
        assert option in options(COMMANDS[name])


def test_commands_with_json_are_those_that_the_readme_names() -> None:
    sentence = re.search(r"((?:`[a-z ]+`(?:,| and)?\s+)+)take `--json`", section(read("README.md"), "Commands"))
    assert sentence
    assert set(spans(sentence[1].replace("\n", " "))) == {
        name for name, command in COMMANDS.items() if "--json" in options(command)
    }


def test_exit_codes_of_the_readme_are_those_of_the_help() -> None:
    text = " ".join((swarm.help or "").split())
    assert "Exit codes: 0 fine, 1 started and failed, 2 refused before anything was started." in text
    readme = " ".join(read("README.md").split())
    assert "Exit codes: 0 fine, 1 started and failed, 2 refused before anything started." in readme
