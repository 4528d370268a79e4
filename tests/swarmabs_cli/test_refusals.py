"""Bad input: exit code 2, one line on standard error that names file, field and remedy, and nothing left behind."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.processes import SEARCH_PATH

from swarmabs_cli import main

ROBOTS = """
    - {id: 1, kind: single_integrator, mass: 0.4, position: 0.1}
    - {id: 2, kind: single_integrator, mass: 0.5, position: -0.1}
"""
GOOD = f"schema: 1\nduration: 0.1\nswarm:\n  agents:{ROBOTS}"


def with_line(line: str) -> str:
    return f"{GOOD}{line}\n"


def with_robots(*robots: str) -> str:
    lines = "".join(f"\n    - {{{robot}}}" for robot in robots)
    return f"schema: 1\nswarm:\n  agents:{lines}\n"


SI = "kind: single_integrator, mass: 0.4, position: 0.1"
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{chr(98 + n)}: &{chr(98 + n)} [{', '.join(['*' + chr(97 + n)] * 9)}]\n" for n in range(9)
)


@dataclass(frozen=True)
class Bad:
    """A scenario file that is refused, and what the refusal must name."""

    text: str
    words: tuple[str, ...]


FILES = {
    "bad YAML": Bad("schema: 1\nswarm: {agents: [\n", ("bad.yaml",)),
    "not a mapping": Bad("- 1\n- 2\n", ("bad.yaml",)),
    "empty": Bad("", ("bad.yaml",)),
    "binary": Bad("\0\1\2", ("bad.yaml",)),
    "unknown key": Bad(with_line("plne: {angle: 0.1}"), ("bad.yaml:7", "plne", "plane")),
    "unknown key below": Bad(with_line("plane: {anlge: 0.1}"), ("bad.yaml:7", "anlge", "angle")),
    "wrong type": Bad(with_line("plane: {angle: steep}"), ("plane.angle", "steep")),
    "negative mass": Bad(with_robots(f"id: 1, {SI.replace('0.4', '-0.4')}", f"id: 2, {SI}"), ("mass", "-0.4")),
    "duplicate id": Bad(with_robots(f"id: 1, {SI}", f"id: 1, {SI}"), ("id",)),
    "one robot": Bad(with_robots(f"id: 1, {SI}"), ("two",)),
    "all at one point": Bad(with_robots(f"id: 1, {SI}", f"id: 2, {SI}"), ("position",)),
    "off the plane": Bad(with_robots(f"id: 1, {SI.replace('0.1', '0.7')}", f"id: 2, {SI}"), ("position", "0.7")),
    "NaN": Bad(with_line("plane: {angle: .nan}"), ("plane.angle", "nan")),
    "infinity": Bad(with_line("plane: {inertia: .inf}"), ("plane.inertia", "inf")),
    "empty preimage": Bad(with_line("manifold: {curvature: 0.0, offset: 0.0001}"), ("manifold",)),
    "step not positive": Bad(with_line("step: 0"), ("step",)),
    "step negative": Bad(with_line("step: -0.01"), ("step",)),
    "duration not positive": Bad(GOOD.replace("0.1\n", "0\n", 1), ("duration",)),
    "duration no multiple": Bad(with_line("step: 0.03"), ("duration", "step")),
    "YAML bomb": Bad(BOMB + GOOD, ("bad.yaml",)),
    "a tag that would execute": Bad(
        with_line("name: !!python/object/apply:os.system ['touch pwned']"), ("bad.yaml", "tag", "os.system")
    ),
    "no robots": Bad("schema: 1\n", ("swarm",)),
    "no schema": Bad(GOOD.replace("schema: 1\n", ""), ("schema",)),
    "another schema": Bad(GOOD.replace("schema: 1", "schema: 2"), ("schema",)),
}


def listing(folder: Path) -> list[tuple[str, int]]:
    """Return everything below a folder, with sizes."""
    return sorted((str(path.relative_to(folder)), path.stat().st_size) for path in folder.rglob("*"))


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working directory: a folder with a good scenario and a folder that is in use."""
    (tmp_path / "good.yaml").write_text(GOOD)
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "precious").write_text("x")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(words: list[str], named: tuple[str, ...], here: Path, capfd: pytest.CaptureFixture[str]) -> str:
    """Check that a command refuses in one line which names some words, and leaves nothing behind."""
    before = listing(here)
    assert main(words) == 2
    output = capfd.readouterr()
    assert output.out == ""
    assert output.err.count("\n") == 1, output.err
    assert output.err.startswith("error: ")
    for word in named:
        assert word in output.err, output.err
    assert listing(here) == before
    return output.err


@pytest.mark.parametrize("case", FILES)
@pytest.mark.parametrize("command", ["run", "simulate"])
def test_a_bad_scenario_file(case: str, command: str, here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (here / "bad.yaml").write_text(FILES[case].text)
    refused([command, "bad.yaml", "-o", "out"], ("bad.yaml", *FILES[case].words), here, capfd)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["missing.yaml"], ("missing.yaml",)),
        (["pd_het4"], ("pd_het4", "did you mean pd_het_4?")),
        (["good.yaml", "-o", "used"], ("used", "not empty", "-o")),
        (["good.yaml", "-o", "good.yaml"], ("good.yaml", "not a folder", "-o")),
        (["good.yaml", "-o", "good.yaml/sub"], ("not a folder", "-o")),
        (["good.yaml", "-o", "/proc/nowhere"], ("/proc/nowhere", "-o")),
        (["good.yaml", "--set", "plane.anlge=1"], ("plane.anlge", "angle")),
        (["good.yaml", "--set", "plane.angle"], ("plane.angle", "=")),
        (["good.yaml", "--set", "swarm.agents.7.mass=1"], ("swarm.agents",)),
        (["good.yaml", "--set", "plane.angle=[1"], ("plane.angle",)),
        (["good.yaml", "--duration", "-1"], ("duration",)),
        (["good.yaml", "--duration", "0.015"], ("duration", "step")),
        (["good.yaml", "--duration", "soon"], ("duration", "soon")),
        *(
            (
                ["good.yaml", "--max-bag-duration", text],
                (
                    "--max-bag-duration",
                    f"a whole number of seconds from 1 to 1000000000, or 0 for a bag in one file, and not '{text}'",
                    "no fractions",
                ),
            )
            for text in ("0.5", "-1", "1000000001", "soon", "nan")
        ),
        (["good.yaml", "--max-bag-size", "1e6"], ("--max-bag-size", "whole number of bytes", "'1e6'")),
        (["good.yaml", "--max-bag-size", str(2**63)], ("--max-bag-size", f"1 to {2**63 - 1}")),
        (["used"], ("used",)),
        (["used/precious.mcap"], ("precious.mcap",)),
        (["good.yaml", "--durations", "1"], ("--durations",)),
        (["good.yaml", "other.yaml"], ("other.yaml",)),
    ],
)
@pytest.mark.parametrize("command", ["run", "simulate"])
def test_bad_words(
    command: str, words: list[str], named: tuple[str, ...], here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    refused([command, *words, *([] if "-o" in words else ["-o", "out"])], named, here, capfd)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["fly"], ("fly",)),
        (["info"], ("BAG",)),
        (["info", "used"], ("used",)),
        (["info", "missing"], ("missing",)),
        (["info", "good.yaml"], ("good.yaml",)),
        (["scenario", "show", "pd_het4"], ("did you mean pd_het_4?",)),
        (["scenario", "draw"], ("draw",)),
        (["env", "used"], ("used",)),
    ],
)
def test_other_commands_refuse_the_same_way(
    words: list[str], named: tuple[str, ...], here: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    refused(words, named, here, capfd)


@pytest.mark.parametrize("below", ["", "sub"])
@pytest.mark.parametrize("command", ["run", "simulate"])
def test_a_folder_without_permission(command: str, below: str, here: Path) -> None:
    closed = here / "closed"
    closed.mkdir(mode=0o555)
    program = (
        "import sys; from tests.privileges import respect_permissions; respect_permissions();"
        "from swarmabs_cli import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, command, "pd_het_4", "-o", closed / below],
        capture_output=True,
        text=True,
        env={**os.environ, **SEARCH_PATH},
        timeout=20,
        check=False,
    )
    (line,) = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
    assert done.returncode == 2
    assert line.startswith(f"error: output folder {closed / below} cannot be ")
    assert line.endswith("choose another with -o")
    assert list(closed.iterdir()) == []


def test_a_refused_command_has_started_nothing(here: Path) -> None:
    """As a process of its own: it has no children and leaves nothing, not even the files of the tracing library."""
    program = (
        "import sys, psutil; from swarmabs_cli import main; code = main(sys.argv[1:]);"
        "sys.exit(99 if psutil.Process().children() else code)"
    )
    before = set(Path("/dev/shm").iterdir())
    done = subprocess.run(
        [sys.executable, "-c", program, "run", "pd_het4"], cwd=here, env=os.environ, timeout=20, check=False
    )
    assert done.returncode == 2
    assert {path.name for path in here.iterdir()} == {"good.yaml", "used"}
    assert set(Path("/dev/shm").iterdir()) <= before
