"""Sample output of commands, and pictures of pages, are those of the commands and small.

A block of output follows a line `<!-- output of: COMMAND -->`. Its lines must occur in what COMMAND prints, in order;
`...` stands for lines that are left out, and the line with the wall time is not compared. `run` is replaced by
`simulate`, which has the same digest.
"""

import re
from pathlib import Path

import pytest
from tests.docs.pages import NAMES, ROOT, read

from swarmabs_cli import main

SHOWN = [
    (name, command, block)
    for name in NAMES
    for command, block in re.findall(r"(?ms)^<!-- output of: ([^\n]*) -->\n```text\n(.*?)^```$", read(name))
]
LARGEST = 180_000
NEW_LARGEST = 150_000
"""Bytes of a picture of gallery and tutorials."""
FILMS = {"rovers.webp": 1_000_000}
"""Largest sizes of films, bytes."""


def lines(text: str) -> list[str]:
    """Return the lines without spaces that only align them."""
    return [" ".join(line.split()) for line in text.splitlines() if line.strip()]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the run that the pages use."""
    folder = tmp_path_factory.mktemp("pages")
    assert main(["simulate", "pd_het_4", "-o", str(folder / "runs" / "pd_het_4-001")]) == 0
    (folder / "examples").symlink_to(ROOT / "examples")
    return folder


@pytest.mark.parametrize(("name", "command", "block"), SHOWN, ids=[f"{name}: {command}" for name, command, _ in SHOWN])
@pytest.mark.system
def test_sample_output_is_what_the_command_prints(
    name: str,
    command: str,
    block: str,
    recorded: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(recorded)
    monkeypatch.setenv("COLUMNS", "160")
    words = command.split()
    if words[0] == "run":
        words = ["simulate", *words[1:], "-o", f"again/{name}"]
    assert main(words) == int("NOT ok" in block)
    printed = iter(lines(capfd.readouterr().out))
    for line in lines(block):
        if line != "..." and not line.startswith("wall time"):
            assert line in printed, f"{name}: {line!r} is not printed here"


def test_there_is_sample_output_and_pictures_are_small() -> None:
    assert len(SHOWN) >= 8
    sizes = {path.name: path.stat().st_size for path in (ROOT / "docs" / "images").iterdir()}
    assert {name: size for name, size in sizes.items() if size > FILMS.get(name, LARGEST)} == {}
    new = {name for name in sizes if name.startswith("gallery_")} | {"first_controller.png", "parent_system.png"}
    assert {name: sizes[name] for name in new if sizes[name] > NEW_LARGEST} == {}
