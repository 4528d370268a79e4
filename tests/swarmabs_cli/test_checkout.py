"""``swarm test`` and ``swarm soak`` in a folder that looks like a checkout; what they would start is not started."""

from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest
from tests.swarmabs_cli.conftest import ran, refused

CHECKS = ("ruff check .", "ruff format --check --quiet .", "mypy")
BY_FILE = "--dist loadfile --max-worker-restart 0"
EVERY_DAY = f"-m not system and not full -n 3 {BY_FILE}"
SYSTEM = f"-m system and not full -n 2 {BY_FILE}"
FULL = f"-m full -n 2 {BY_FILE}"


@pytest.fixture
def started(here: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Return what is started on a machine with three cores, and its exit codes: a signal's if "dies" is in it."""
    (here / "scripts").mkdir()
    (here / "scripts" / "swarm").touch()
    (here / "tests").mkdir()
    found: dict[str, int] = {}

    def run(words: list[str], cwd: Path, env: dict[str, str], **_: Any) -> CompletedProcess[str]:
        assert (cwd, env["PYTHONPATH"].split(":")[0]) == (here, str(here))
        module = " ".join(words[2:])
        return CompletedProcess(words, found.setdefault(module, -9 if "dies" in module else 0))

    monkeypatch.setattr("subprocess.run", run)
    monkeypatch.setattr("os.cpu_count", lambda: 3)
    return found


@pytest.mark.parametrize(
    ("words", "modules"),
    [
        ("", (*CHECKS, f"pytest {EVERY_DAY}")),
        ("--system", (f"pytest {SYSTEM}",)),
        ("--full", (*CHECKS, *(f"pytest --full {tier}" for tier in (EVERY_DAY, SYSTEM, FULL)))),
        ("--full tests", ("pytest --full tests",)),
        *((words, (f"pytest {words}",)) for words in ("tests/dies", "-k system --lf --durations=5 --cov --full-trace")),
        ("-- --full", ("pytest --full",)),
        (
            "--coverage tests",
            (
                "coverage run --data-file=log/coverage/data -m pytest tests",
                "coverage combine --quiet --data-file=log/coverage/data",
                "tests.coverage_table log/coverage",
            ),
        ),
    ],
)
def test_what_is_started(words: str, modules: tuple[str, ...], here: Path, started: dict[str, int]) -> None:
    ran("test", *words.split(), code=1 if "dies" in words else 0)
    assert tuple(module.replace(f"{here}/", "") for module in started) == modules


@pytest.mark.parametrize(
    ("words", "module"),
    [
        ("", "pytest --full --hypothesis-profile=hours tests/soak"),
        ("--virtual", "tests.virtual.search"),
        ("--virtual --seeds 1-9 --minutes 2", "tests.virtual.search --seeds 1-9 --minutes 2.0"),
    ],
)
def test_what_a_soak_starts(words: str, module: str, started: dict[str, int]) -> None:
    ran("soak", *words.split())
    assert [*started] == [module]
    assert "--seeds belongs to --virtual" in refused("soak", "--seeds", "3")


def test_an_option_of_its_own_that_is_misspelt_is_refused_with_the_right_one(started: dict[str, int]) -> None:
    for word in ("--systm", "--sytem=1", "-system", "--ful", "--covrage"):
        near = {"s": "--system", "f": "--full", "c": "--coverage"}[word.lstrip("-")[0]]
        assert f"Did you mean '{near}'?" in refused("test", "tests", word)
    assert started == {}


def test_no_tests_after_a_failed_check(here: Path, started: dict[str, int], monkeypatch: pytest.MonkeyPatch) -> None:
    started["mypy"] = 3
    ran("test", code=3)
    assert started.keys() == {*CHECKS}
    (here / "scripts" / "swarm").unlink()
    monkeypatch.setattr("sys.prefix", str(here))
    assert "is not in a checkout of swarmabs; change into one" in ran("test", code=2).err
