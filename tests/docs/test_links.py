"""Links and paths resolve; commands and options that pages name exist, and those that exist are named."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from tests.docs.pages import NAMES, ROOT, blocks, read, spans

from swarmabs_cli import swarm

PATH = r"(?:docs|examples|scripts|src|tests)/[\w./*-]*"


def anchors(path: Path) -> set[str]:
    """Return the anchors that headings of a page have where Markdown is shown."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def broken(name: str, text: str) -> Iterator[str]:
    page = ROOT / name
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        place, _, anchor = target.partition("#")
        path = (page.parent / place).resolve() if place else page
        if not path.exists() or (anchor and anchor not in anchors(path)):
            yield target


def test_links_resolve() -> None:
    wrong = "[a](docs/nothing.md) [b](docs/README.md#nothing) [c](docs/reference/bag.md#digest) [d](#nothing) [e](https://x.y)"
    assert list(broken("README.md", wrong)) == ["docs/nothing.md", "docs/README.md#nothing", "#nothing"]
    assert {name: found for name in NAMES if (found := list(broken(name, read(name))))} == {}


def test_every_page_can_be_reached_from_the_readme() -> None:
    reached, pending = set(), ["README.md"]
    while pending:
        name = pending.pop()
        if name in reached or not name.endswith(".md"):
            continue
        reached.add(name)
        targets = re.findall(r"\]\(([^)#\s:]+)", read(name))
        pending += [str(((ROOT / name).parent / target).resolve().relative_to(ROOT)) for target in targets]
    assert reached == set(NAMES)


def test_paths_exist() -> None:
    """Paths set as code, such as docs/figures/run.py; those that only a run or the set-up makes are left out."""
    named = {path for name in NAMES for path in spans(read(name)) if re.fullmatch(PATH, path)}
    assert {path for path in named if not list(ROOT.glob(path.rstrip("/")))} == set()


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


def test_invocations_exist() -> None:
    found = [words for name in NAMES for words in invocations(read(name)) if words]
    assert ["run"] in found
    assert ["scenario", "list"] in found
    for words in found:
        command = next((" ".join(words[:n]) for n in (2, 1) if " ".join(words[:n]) in COMMANDS), None)
        assert command, f"no command: swarm {' '.join(words)}"
        passing_on = "ignore_unknown_options" in COMMANDS[command].context_settings
        for word in words:
            if word.startswith("-") and not passing_on:
                assert word in options(COMMANDS[command]), f"no option: swarm {' '.join(words)}"


@pytest.mark.parametrize("folder", ["tutorials", "how-to", "explanation"])
def test_pages_to_be_read_from_start_to_end_are_short(folder: str) -> None:
    """The limit of CONTRIBUTING.md; the reference is not read in one go."""
    counts = {name: len(read(name).split()) for name in NAMES if name.startswith(f"docs/{folder}/")}
    assert counts
    assert {name: count for name, count in counts.items() if count > 2500} == {}
