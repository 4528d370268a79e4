"""Links between pages, to files and to headings resolve."""

from __future__ import annotations

import re
import subprocess
from typing import TYPE_CHECKING

import pytest
from tests.docs.pages import NAMES, ROOT, read

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


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


@pytest.mark.parametrize("name", NAMES)
def test_links_resolve(name: str) -> None:
    assert list(broken(name, read(name))) == []


def test_broken_links_are_found() -> None:
    text = (
        "[a](docs/nothing.md) [b](docs/design.md#nothing) [c](docs/design.md#scenario) [d](#nothing) [e](https://x.y)"
    )
    assert list(broken("README.md", text)) == ["docs/nothing.md", "docs/design.md#nothing", "#nothing"]


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


@pytest.mark.parametrize("name", NAMES)
def test_paths_exist(name: str) -> None:
    """Paths set as code, such as docs/figures/run.py; those that only a run or the set-up makes are left out."""
    text = re.sub(r"^```.*?^```", "", read(name), flags=re.MULTILINE | re.DOTALL)
    for path in re.findall(r"`((?:docs|examples|scripts|src|tests)/[\w./*-]*)`", text):
        assert list(ROOT.glob(path.rstrip("/"))), path


def test_no_page_is_ignored_by_git() -> None:
    code = subprocess.run(["git", "check-ignore", *NAMES], cwd=ROOT, capture_output=True, check=False).returncode
    assert code in {1, 128}  # none of them, or no checkout of git
