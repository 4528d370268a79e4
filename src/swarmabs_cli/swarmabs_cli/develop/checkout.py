"""Commands that need files of the checkout: ``bench``, ``docs``, ``soak``, ``test`` and ``wheel``."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import NamedTuple

import click

from swarmabs_cli.options import Number, WholeNumber, examples, json_option, output_option
from swarmabs_core.errors import InputError
from swarmabs_run.ending import GRACE, die_with_parent

SUITES = ("product", "start", "memory", "large", "simulate", "sweep", "recorder", "reading", "functions")
_LONGEST_WARM_UP = 2.0
"""Longest warm-up before a measurement, s; at most a third of its length."""

MOST_PROCESSES = 4
"""Largest number of processes for the everyday tests; each takes some 500 MB."""

_RESEMBLES = 0.75
"""Similarity (`difflib`) at which a word counts as a misspelt option; pytest has --cov and --full-trace."""


def _numbers(_context: click.Context, _option: click.Parameter, text: str) -> tuple[int, ...]:
    """Parse a list of numbers of robots."""
    try:
        numbers = tuple(int(word) for word in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list such as 4,20") from None
    if min(numbers) < 2:
        raise click.BadParameter(f"{min(numbers)} is too few; a swarm has at least 2 robots")
    return numbers


@click.command(epilog=examples("bench --suite product --robots 4,20"))
@click.option(
    "--suite",
    "suites",
    type=click.Choice((*SUITES, "all")),
    multiple=True,
    default=("all",),
    show_default=True,
    help="What to measure; repeatable.",
)
@click.option(
    "--robots",
    default="4,20,64,200",
    show_default=True,
    callback=_numbers,
    metavar="N,N",
    help="Numbers of robots.",
)
@click.option("--repeat", type=WholeNumber(1), default=3, show_default=True, help="Number of measurements.")
@click.option(
    "--window",
    type=Number(0.1),
    default=6.0,
    show_default=True,
    metavar="SECONDS",
    help="Length of a measurement.",
)
@click.option(
    "--starts",
    type=WholeNumber(1),
    metavar="N",
    help="Number of runs in the suites start and memory.  [default: as --repeat]",
)
@click.option("--busy", is_flag=True, help="Keep all cores busy during these runs.")
@click.option(
    "--large",
    default="200,500,1000,2000",
    show_default=True,
    callback=_numbers,
    metavar="N,N",
    help="Numbers of robots in the suite large.",
)
@click.option(
    "--agents-per-process",
    type=WholeNumber(1),
    default=50,
    show_default=True,
    help="Robots per process in the suite large.",
)
@click.option(
    "--compare",
    nargs=2,
    type=click.Path(path_type=Path),
    metavar="OLD NEW",
    help="Compare two results (folder or bench.json) instead of measuring.",
)
@output_option("Folder of the result.  [default: runs/bench-NNN]")
@json_option
def bench(
    suites: tuple[str, ...],
    window: float,
    compare: tuple[Path, Path] | None,
    output: Path | None,
    *,
    as_json: bool,
    **settings: object,
) -> None:
    """Measure performance next to DDS, ZeroMQ and MCAP baselines.

    The result is a folder with bench.json, bench.md and a chart. For how to read it, see
    docs/explanation/performance.md.
    """
    chosen = [suite for suite in SUITES if suite in suites or "all" in suites]
    settings |= {"suites": chosen, "window": window, "warm_up": min(_LONGEST_WARM_UP, window / 3.0)}
    asked = {"settings": settings, "compare": compare, "output": output, "as_json": as_json}
    command = [sys.executable, "-m", "benchmarks.bench", json.dumps(asked, default=str)]
    os.execve(sys.executable, command, _variables())  # noqa: S606 - no shell is wanted


@click.command(epilog=examples("docs"))
@output_option("Folder of the site; an existing site is replaced.  [default: build/docs]")
def docs(output: Path | None) -> int:
    """Build the documentation and the Python API as one site of HTML pages.

    The site needs no network. Any warning, such as a broken link, makes the exit code 1.
    """
    folder = (output or _checkout() / "build" / "docs").absolute()
    if folder.exists() and not (folder / "sitemap.xml").is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} was not built by this command; name a new or an empty folder with -o")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder} cannot be made: {error.strerror}; name another folder with -o") from error
    return _run(["docs.build_site", str(folder)], NO_MKDOCS_2_WARNING="1")


@click.command(epilog=examples("wheel -o dist"))
@output_option("Folder of the wheel.  [default: build/wheel]")
def wheel(output: Path | None) -> int:
    """Build a wheel with everything that needs no ROS, for pip on any platform.

    The same sources give the same bytes.
    """
    folder = (output or _checkout() / "build" / "wheel").absolute()
    return _run(["scripts.build_wheel", str(folder)])


@click.command(epilog=examples("soak --virtual --minutes 5", "soak --virtual --seeds 17"))
@click.option("--virtual", is_flag=True, help="Run the nodes of fleets on a virtual clock and network.")
@click.option("--seeds", metavar="A-B", help="Seeds, or one that is shown with its timeline.  [default: new ones]")
@click.option("--only", metavar="N,N", help="Numbers of the faults of the seed that happen; none: no fault.")
@click.option("--minutes", type=Number(0.0), help="Longest time.  [default: 30 without --seeds]")
@click.option("--jobs", type=WholeNumber(1), help="Number of processes.  [default: one per core]")
@click.option("--trace", type=click.Path(path_type=Path), help="File of all that is said and heard in one seed.")
def soak(*, virtual: bool, **given: object) -> int:
    """Search for faults with drawn scenarios; each failure states the command that repeats it.

    Without --virtual these are 1,000 scenarios in lockstep with injected faults. With --virtual, nodes in real time
    meet crashes, pauses, partitions, loss, wrong clocks, forged messages and operators, each drawn from a seed. See
    docs/developers/virtual_fleets.md.
    """
    words = [word for name, value in given.items() if value is not None for word in (f"--{name}", str(value))]
    if virtual:
        return _run(["tests.virtual.search", *words])
    if words:
        raise InputError(f"{words[0]} belongs to --virtual; add --virtual or omit it")
    return _run(["pytest", "--full", "--hypothesis-profile=hours", "tests/soak"])


class Tier(NamedTuple):
    """Tests by their marks, and the largest number of processes that share them."""

    marks: str
    processes: int

    def arguments(self) -> list[str]:
        """Return the arguments of pytest."""
        processes = str(min(self.processes, os.cpu_count() or 1))
        # A test that ends its process ends the tests: with a new process, they may wait for ever.
        return ["-m", self.marks, "-n", processes, "--dist", "loadfile", "--max-worker-restart", "0"]


TIERS = (Tier("not system and not full", MOST_PROCESSES), Tier("system and not full", 2), Tier("full", 2))
"""The everyday tests, those with real processes, and the long ones."""


@click.command(
    context_settings={"ignore_unknown_options": True},
    epilog=examples("test", "test --system", "test tests/swarmabs_core -k manifold"),
)
@click.option("--system", is_flag=True, help="Run the tests of processes, DDS, browser and hosts instead.")
@click.option("--full", is_flag=True, help="Run all tests, including storms, soaks and fuzzing.")
@click.option("--coverage", is_flag=True, help="Measure line and branch coverage, subprocesses included.")
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def test(pytest_arguments: tuple[str, ...], *, system: bool, full: bool, coverage: bool) -> int:
    """Run the linters, the type checker and the everyday tests.

    PYTEST_ARGUMENTS select tests; then only pytest runs. With --coverage the result is a table by package and, in
    log/coverage, annotated pages.
    """
    _refuse_misspelt(pytest_arguments)
    pytest = ["pytest", *(["--full"] if full else [])]
    if pytest_arguments:
        runs = [[*pytest, *pytest_arguments]]
    else:
        chosen = TIERS if full else TIERS[1:2] if system else TIERS[:1]
        runs = [[*pytest, *tier.arguments()] for tier in chosen]
    if not (pytest_arguments or system):
        for check in (["ruff", "check", "."], ["ruff", "format", "--check", "--quiet", "."], ["mypy"]):
            if code := _run(check):
                return code
    if not coverage:
        return max(map(_run, runs))
    folder = _checkout() / "log" / "coverage"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    where = f"--data-file={folder / 'data'}"
    measured = [_run(["coverage", "run", where, "-m", *run], **{GRACE: "60"}) for run in runs]
    told = [["coverage", "combine", "--quiet", where], ["tests.coverage_table", str(folder)]]
    return max(*measured, *map(_run, told))


def _refuse_misspelt(words: tuple[str, ...]) -> None:
    """Reject a word that resembles an option of this command; all other options are passed to pytest."""
    context = click.get_current_context()
    own = [name for parameter in context.command.params for name in parameter.opts if name.startswith("--")]
    for name in (word.partition("=")[0] for word in words if word.startswith("-")):
        if name not in own and (near := get_close_matches(name, own, cutoff=_RESEMBLES)):
            raise click.NoSuchOption(name, possibilities=near, ctx=context)


def _run(words: list[str], **environment: str) -> int:
    """Run a Python module with arguments; return its exit code. It ends with this process."""
    click.echo(f"== {' '.join(words)}", err=True)
    command = [sys.executable, "-m", *words]
    code = subprocess.run(
        command,
        cwd=_checkout(),
        env={**_variables(), **environment},
        check=False,
        preexec_fn=partial(die_with_parent, os.getpid()),  # makes only a system call
    ).returncode
    return 1 if code < 0 else code


def _variables() -> dict[str, str]:
    """Return the environment for a module of the checkout that is not installed."""
    search = os.pathsep.join(filter(None, (str(_checkout()), os.environ.get("PYTHONPATH"))))
    return {**os.environ, "PYTHONPATH": search}


def _checkout() -> Path:
    """Return the checkout that contains the current folder or the interpreter."""
    for start in (Path.cwd(), Path(sys.prefix)):
        for folder in (start, *start.parents):
            if (folder / "scripts" / "swarm").is_file() and (folder / "tests").is_dir():
                return folder
    raise InputError(f"{Path.cwd()} is not in a checkout of swarmabs; change into one")
