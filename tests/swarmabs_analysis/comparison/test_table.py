"""What a comparison looks like: no number and no heading is cut, on terminals of any width and in pipes."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from tests.processes import SEARCH_PATH
from tests.swarmabs_bag.sample_run import make_run, write_bag

from swarmabs_analysis.comparison.bags import Comparison, compare_bags
from swarmabs_cli import main
from swarmabs_core.messages import AgentState, Message, PlaneState

pytestmark = pytest.mark.timeout(60)


def shifted(message: Message, infinite: float) -> Message:
    """Change every number of robots and plane by a little, or make it infinite."""
    if not isinstance(message, (AgentState, PlaneState)):
        return message
    values = {n: v * (1 + 1e-5) + infinite for n, v in message._asdict().items() if isinstance(v, float)}
    return message._replace(**values)


@pytest.fixture(scope="module", params=[0.0, float("inf")], ids=["finite", "infinite"])
def bags(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    run = make_run()
    return [write_bag(folder / "a", run), write_bag(folder / "b", [shifted(m, request.param) for m in run])]


def on_a_terminal(*words: object, columns: int) -> str:
    """Return what a command prints on a terminal of some width, without colours."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, **SEARCH_PATH, "COLUMNS": str(columns), "TERM": "xterm"}
    command = [sys.executable, "-m", "swarmabs_cli", *map(str, words)]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs, env=environment):
        os.close(theirs)
        printed = b""
        try:
            while piece := os.read(ours, 65536):
                printed += piece
        except OSError:  # how a terminal ends
            pass
        finally:
            os.close(ours)
    return re.sub(r"\x1b\[[0-9;]*m", "", printed.decode()).replace("\r\n", "\n")


def expected(found: Comparison) -> list[list[str]]:
    """Return for each field that differs the words that have to be read beside it."""
    return [
        [f.field, f"{f.differing:,}", *("-" if n is None else f"{n:.6g}" for n in (f.largest, f.rms))]
        for topic in found.messages.topics
        for f in topic.fields
    ]


def assert_readable(text: str, found: Comparison) -> None:
    """Assert that fields stand in their order, with all of their numbers before the next one."""
    rest = " ".join(text.split())
    assert "…" not in rest
    rows = expected(found)
    assert len(rows) == 7
    places = []
    for row in rows:
        place = re.compile(rf" {row[0]}\b").search(rest, places[-1] + 1 if places else rest.rindex("swarm/agent_state"))
        assert place, row
        places.append(place.start())
    for row, (begin, end) in zip(rows, pairwise([*places, len(rest)]), strict=True):
        words = re.split(r"[ :,](?!\d{3}\b)", rest[begin:end])
        assert set(row) <= set(words), (row, words)


@pytest.mark.parametrize("columns", [200, 80, 40])
def test_on_a_terminal_every_number_is_there_and_no_line_is_too_long(bags: list[Path], columns: int) -> None:
    text = on_a_terminal("compare", *bags, columns=columns)
    assert max(map(len, text.splitlines())) <= columns
    assert_readable(text, compare_bags(*bags))


def test_a_usual_terminal_has_a_table(bags: list[Path]) -> None:
    text = on_a_terminal("compare", *bags, columns=80)
    infinite = "not finite" in text
    assert bool(re.search(r"^field +differ +largest +at step +agent +rms\s*$", text, re.MULTILINE)) is not infinite
    assert re.search(r"^ topic +in both +differ +not in A +not in B", text, re.MULTILINE)


def test_in_a_pipe_no_line_is_broken(
    bags: list[Path], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["compare", *map(str, bags)]) == 1
    text = capfd.readouterr().out
    found = compare_bags(*bags)
    assert_readable(text, found)
    lines = text.splitlines()
    for row in expected(found):
        assert any(set(row) <= set(line.split()) for line in lines), row
    assert any(str(found.a.digest) in line and str(found.b.digest) in line for line in lines)
    assert any(found.a.file in line and found.b.file in line for line in lines)
