"""Messages that the documentation quotes are messages of the code."""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING

import pytest
from tests.docs.pages import ROOT, read, rows, spans

if TYPE_CHECKING:
    from collections.abc import Iterator

SHORTEST = 8
"""Shortest text, letters, that is looked for."""
# Names, numbers and signs that stand for what is filled in; what is between them is the code's own text.
_FILLED = re.compile(r"'?[A-Z][A-Z]+'?(:[A-Z]+)*|\.\.\.|\d[\d.]*|\bX\b|\b[KN]\b|agent[_ ]|\bhas\b|[;:()?/|,]| of ")


def texts() -> str:
    """Return all constant parts of texts in the sources, those of formatted texts piece by piece."""
    found = []
    for folder in ("src", "scripts"):
        for path in [*(ROOT / folder).rglob("*.py"), ROOT / "scripts" / "swarm"]:
            if "install" in path.parts:
                continue
            nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            constants = (node.value for node in nodes if isinstance(node, ast.Constant))
            found.extend(" ".join(text.split()) for text in constants if isinstance(text, str))
    return "\n".join(found)


TEXTS = texts()


def fragments(quoted: str) -> Iterator[str]:
    for part in _FILLED.split(quoted):
        if part is not None and len(part.strip(" '")) >= SHORTEST:
            yield part.strip(" '")


def quoted_messages() -> list[str]:
    messages, *_ = read("docs/troubleshooting.md").partition("\n## Results")
    cells = [row[0] for row in rows(messages)]
    return [span for span in spans("\n".join(cells)) if " " in span]


@pytest.mark.parametrize("quoted", quoted_messages())
def test_quoted_messages_are_those_of_the_code(quoted: str) -> None:
    for fragment in fragments(quoted):
        assert fragment in TEXTS, fragment


def test_most_quotations_have_something_to_look_for() -> None:
    without = [quoted for quoted in quoted_messages() if not list(fragments(quoted))]
    assert len(without) < len(quoted_messages()) / 8, without


def test_unknown_messages_are_found() -> None:
    assert [f for f in fragments("the plane has flown away at step K") if f not in TEXTS]


def test_tests_that_the_errata_name_exist() -> None:
    named = re.findall(r"`(?:(test_\w+\.py)::)?(test_\w+)`", read("docs/errata.md"))
    assert named
    file = ""
    for given, test in named:
        file = given or file
        paths = list((ROOT / "tests").rglob(file))
        assert any(f"def {test}(" in path.read_text(encoding="utf-8") for path in paths), f"{file}::{test}"
