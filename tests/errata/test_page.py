"""The pages on errata and the tests of this folder belong together: a row for every test, a test for every row."""

import re
from pathlib import Path

from tests.docs.pages import read, rows

HERE = Path(__file__).parent
COLUMNS = 5


def named() -> list[str]:
    """Return the tests that the rows of the page name, as file::test."""
    names = []
    for cells in rows(read("docs/explanation/errata.md") + read("docs/explanation/errata_controllers.md")):
        assert len(cells) == COLUMNS, cells
        assert all(cells), cells
        match = re.fullmatch(r"`(test_\w+\.py::test_\w+)`", cells[-1])
        assert match, f"no test of the form `file.py::test`: {cells[-1]}"
        names.append(match[1])
    return names


def existing() -> list[str]:
    """Return the tests of this folder but those of this file."""
    return [
        f"{path.name}::{name}"
        for path in sorted(HERE.glob("test_*.py"))
        if path != Path(__file__)
        for name in re.findall(r"^def (test_\w+)\(", path.read_text(encoding="utf-8"), re.MULTILINE)
    ]


def test_every_row_has_a_test_and_every_test_a_row() -> None:
    assert named()
    assert set(named()) == set(existing())
