"""Show which seeded mutants the tests notice: ``./scripts/swarm test -p tests.mutants --mutate src/PACKAGE TESTS``.

A mutant is a function with one change. Each is tried in a fork of a process that has collected the tests and run none,
by those tests that run the changed line, quick ones first; where only other processes run it, by the tests that start
processes (`smoke`); where only imports do, by a process that imports it. mutmut and cosmic-ray start a process for
each, which takes seconds instead of tenths.
"""

import ast
import ctypes
import gc
import json
import marshal
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import copy
from functools import partial
from hashlib import sha256
from operator import itemgetter
from pathlib import Path
from select import select
from tempfile import TemporaryFile, gettempdir
from types import CodeType, FunctionType
from typing import Any, NamedTuple

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import Phase, settings
from tests.processes import SEARCH_PATH, carrying

PLACE = Path(gettempdir()) / f"mutant-{os.getpid()}"
"""Where the processes that a test starts find the code of the mutant, by `tests/mutated`."""
for search in (os.environ, SEARCH_PATH):
    search["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parent / "mutated"), search.get("PYTHONPATH", "")])

TOOL = 4
"""Number under which lines are watched; those below belong to debuggers and coverage."""
LONGEST = 20.0
"""Time, s, of the tests that are asked about a mutant; four times as much, and it counts as noticed since one hangs."""
MOST_PROCESSES = 100.0
"""The same of tests that start processes."""
MISSED, NOTICED, UNFIT = range(3)
PR_SET_PDEATHSIG = 1

PAIRS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.Gt: ast.GtE,
    ast.Eq: ast.NotEq,
    ast.In: ast.NotIn,
    ast.Is: ast.IsNot,
    ast.Add: ast.Sub,
    ast.Mult: ast.Div,
    ast.BitAnd: ast.BitOr,
    ast.And: ast.Or,
}
OPERATORS = PAIRS | {new: old for old, new in PAIRS.items()} | dict.fromkeys((ast.FloorDiv, ast.Mod, ast.Pow), ast.Mult)
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "floor": "ceil", "ceil": "floor", "sin": "cos"}
SKIPPED = {"annotation", "returns", "decorator_list", "exc"}
"""Parts of nodes without behaviour, and what an error says."""


class Mutant(NamedTuple):
    """The change with this number among those of a file, its lines, and the code before and after."""

    path: str
    number: int
    lines: range
    text: str


def changed(node: Any) -> Iterator[ast.AST]:
    """Yield what may stand in place of a node."""

    def having(**fields: object) -> ast.AST:
        new = copy(node)
        vars(new).update(fields)
        return new

    match node:
        case ast.Compare(ops=[first, *rest]):
            yield having(ops=[OPERATORS[type(first)](), *rest])
        case ast.BinOp() | ast.BoolOp() if type(node.op) in OPERATORS:
            yield having(op=OPERATORS[type(node.op)]())
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.Constant(value=bool()):
            yield having(value=not node.value)
        case ast.Constant(value=int() | float()):
            yield having(value=node.value + 1)
        case ast.If() | ast.While() | ast.IfExp():
            yield having(test=ast.UnaryOp(ast.Not(), node.test))
        case ast.Return(value=ast.expr()):
            yield having(value=ast.Constant(None))
        case ast.Call(func=ast.Name(id=name)) if name in NAMES:
            yield having(func=ast.Name(NAMES[name], ast.Load()))
        case ast.Call(args=[first, second, *rest]):
            yield having(args=[second, first, *rest])
        case (
            ast.Expr(value=ast.Call())
            | ast.Assign(targets=[ast.Attribute() | ast.Subscript()])
            | ast.AugAssign()
            | ast.Continue()
            | ast.Break()
        ):
            yield ast.Pass()


class Seeder(ast.NodeTransformer):
    """Finds all changes of a module's functions, and makes the one that is wanted."""

    def __init__(self, wanted: int = -1) -> None:
        self.wanted, self.found, self._inside = wanted, list[tuple[range, str]](), False

    def visit(self, node: Any) -> Any:
        for new in changed(node) if self._inside else ():
            place = node.test if isinstance(node, ast.If | ast.While) else node
            self.found.append((range(node.lineno, place.end_lineno + 1), f"{text_of(node)} -> {text_of(new)}"))
            if len(self.found) - 1 == self.wanted:
                return ast.fix_missing_locations(ast.copy_location(new, node))
        return self.generic_visit(node)

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Go on with the parts that have a behaviour; of functions, inside of them."""
        if isinstance(node, ast.JoinedStr):
            return node
        before = self._inside
        for name, part in ast.iter_fields(node):
            self._inside = before or (name == "body" and isinstance(node, ast.FunctionDef | ast.Lambda))
            if isinstance(part, list) and name not in SKIPPED:
                part[:] = [self.visit(each) if isinstance(each, ast.AST) else each for each in part]
            elif isinstance(part, ast.AST) and name not in SKIPPED:
                setattr(node, name, self.visit(part))
        self._inside = before
        return node


def text_of(node: ast.AST) -> str:
    """Return the first line of a node's code, shortened."""
    return ast.unparse(node).split("\n")[0][:90]


def mutants_of(path: Path) -> list[Mutant]:
    seeder = Seeder()
    seeder.visit(ast.parse(path.read_bytes()))
    return [Mutant(str(path), number, lines, text) for number, (lines, text) in enumerate(seeder.found)]


def codes(code: CodeType) -> Iterator[CodeType]:
    """Yield the code of all functions within a code, from the outside to the inside."""
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield each
            yield from codes(each)


def put_in(mutant: Mutant) -> bool:
    """Give the functions of this process, and those that it starts, a mutant's code; tell whether one was to change."""
    text = Path(mutant.path).read_bytes()
    tree = Seeder(mutant.number).visit(ast.parse(text))
    module = compile(tree, mutant.path, "exec")
    PLACE.write_bytes(marshal.dumps(module))
    os.environ["SWARMABS_MUTANT"] = str(PLACE)
    new = {(each.co_qualname, each.co_firstlineno): each for each in codes(module)}
    for function in gc.get_objects():
        if isinstance(function, FunctionType) and function.__code__.co_filename == mutant.path:
            function.__code__ = new[function.__code__.co_qualname, function.__code__.co_firstlineno]
    return ast.dump(tree) != ast.dump(ast.parse(text))


class Watch:
    """Notes which lines of the files run in a test, those of its fixtures included, whoever has set them up."""

    def __init__(self, files: set[str]) -> None:
        self._files, self._now = files, set[tuple[str, int]]()
        self._fixtures: dict[str, set[tuple[str, int]]] = {}
        sys.monitoring.use_tool_id(TOOL, "mutants")
        sys.monitoring.register_callback(TOOL, sys.monitoring.events.LINE, self._line)
        sys.monitoring.set_events(TOOL, sys.monitoring.events.LINE)

    def _line(self, code: CodeType, line: int) -> object:
        if code.co_filename in self._files:
            self._now.add((code.co_filename, line))
        return sys.monitoring.DISABLE  # until all are watched anew

    def _anew(self) -> None:
        self._now = set()
        sys.monitoring.restart_events()

    def end(self) -> set[tuple[str, int]]:
        """Watch no longer; return what has run."""
        sys.monitoring.set_events(TOOL, sys.monitoring.events.NO_EVENTS)
        sys.monitoring.free_tool_id(TOOL)
        return self._now

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[None]:
        before = self._now
        self._anew()
        try:
            return (yield)
        finally:
            self._fixtures.setdefault(fixturedef.argname, set()).update(self._now)
            self._now |= before

    def test(self, item: Any, following: pytest.Item | None) -> tuple[float, list[tuple[str, int]]] | None:
        """Run a test; return the time it took, s, and the lines, or nothing if it was skipped or failed."""
        self._anew()
        began = time.monotonic()
        reports = runtestprotocol(item, log=False, nextitem=following)
        took = time.monotonic() - began
        lines = self._now.union(*(self._fixtures.get(name, ()) for name in item.fixturenames))
        return (took, sorted(lines)) if all(report.passed for report in reports) else None


IMPORTING = pytest.StashKey[Watch]()


def forked(act: Callable[[], int]) -> int:
    """Return the process that acts, and then ends with what it returns; it is killed with this one."""
    process = os.fork()
    if not process:
        code = UNFIT
        try:
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
            os.setpgid(0, 0)
            code = act()
        finally:
            os._exit(code)
    return process


def ended(process: int, patience: float | None) -> int:
    """Return with what a process has ended; one that does not in time (s), or crashes, has noticed something."""
    place = os.pidfd_open(process)
    hangs = not select([place], [], [], patience)[0]
    os.close(place)
    with suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)  # also what a test has left behind
    for left in carrying(f"SWARMABS_MUTANT={PLACE}"):
        with suppress(ProcessLookupError):
            os.kill(left, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    return NOTICED if hangs or code < 0 else code


def tried(mutant: Mutant, items: list[pytest.Item]) -> int:
    if not put_in(mutant):
        return UNFIT
    for item, following in zip(items, [*items[1:], None], strict=True):
        if any(report.failed for report in runtestprotocol(item, log=False, nextitem=following)):
            return NOTICED
    return MISSED


def imported(mutant: Mutant, config: pytest.Config) -> int:
    """Run the tests in a process that imports the mutant, up to the first that fails."""
    if not put_in(mutant):
        return UNFIT
    words = [sys.executable, "-m", "pytest", "--exitfirst", *config.invocation_params.args]
    nowhere = subprocess.DEVNULL
    return NOTICED if subprocess.call(words, cwd=config.rootpath, stdout=nowhere, stderr=nowhere) else MISSED


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("mutants")
    group.addoption("--mutate", action="append", default=[], metavar="PATH", help="a module or folder of the sources")
    group.addoption("--mutants", type=int, default=100, metavar="N", help="how many of its mutants to try")
    group.addoption("--mutants-seed", default="0", metavar="TEXT", help="which of them")


@pytest.hookimpl(tryfirst=True)
def pytest_load_initial_conftests(early_config: pytest.Config) -> None:
    """Import the packages from their sources, not from where they are installed, and watch which lines that runs."""
    sources = [str(folder) for folder in sorted(early_config.rootpath.glob("src/*"))]
    sys.path[:0] = sources
    for search in (os.environ, SEARCH_PATH):
        search["PYTHONPATH"] = os.pathsep.join([*sources, search["PYTHONPATH"]])
    early_config.stash[IMPORTING] = Watch({mutant.path for mutant in sample(early_config)})


@pytest.hookimpl(trylast=True)
def pytest_configure() -> None:
    """Do without shorter examples of what fails."""
    found = settings.get_profile(settings.get_current_profile_name())
    settings.register_profile("mutants", found, phases=(Phase.explicit, Phase.generate))
    settings.load_profile("mutants")


def sample(config: pytest.Config) -> list[Mutant]:
    """Return the mutants that are asked for; whether one is among them does not depend on other files."""
    asked = config.known_args_namespace
    paths = [Path(path).resolve() for path in asked.mutate]
    files = [file for path in paths for file in ([path] if path.is_file() else sorted(path.rglob("*.py")))]

    def rank(mutant: Mutant) -> bytes:
        name = os.path.relpath(mutant.path, config.rootpath)
        return sha256(f"{asked.mutants_seed} {name} {mutant.number}".encode()).digest()

    every = [mutant for file in files for mutant in mutants_of(file)]
    return sorted(every, key=rank)[: asked.mutants]


def watched(items: list[Any], files: set[str]) -> list[tuple[float, set[tuple[str, int]], Any]]:
    """Run the tests in another process; return time (s) and lines of each that passes, and the test."""
    with TemporaryFile("w+", encoding="utf-8") as notes:

        def act() -> int:
            watch = Watch(files)
            items[0].config.pluginmanager.register(watch)
            pairs = zip(items, [*items[1:], None], strict=True)
            json.dump([watch.test(item, following) for item, following in pairs], notes)
            notes.flush()
            return 0

        if ended(forked(act), None):
            raise pytest.UsageError("the tests cannot be watched")
        notes.seek(0)
        found = zip(json.load(notes), items, strict=True)
    return [(note[0], {tuple(line) for line in note[1]}, item) for note, item in found if note is not None]


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop(session: pytest.Session) -> bool | None:
    at_import = session.config.stash[IMPORTING].end()
    if "SWARMABS_MUTANT" in os.environ:
        return None
    say = session.config.get_terminal_writer().line
    mutants = sample(session.config)
    seen = watched(session.items, {mutant.path for mutant in mutants})
    say(f"{len(mutants)} mutants, {len(seen)} tests that pass without")
    counts: dict[str, Counter[int]] = {}
    for mutant in mutants:
        places = {(mutant.path, line) for line in mutant.lines}
        asked, total = list[pytest.Item](), 0.0
        fit = [each for each in seen if each[1] & places]
        importing, longest = not fit and at_import & places, LONGEST if fit else MOST_PROCESSES
        fit = fit or [each for each in seen if each[2].get_closest_marker("smoke")]
        for took, _, item in sorted(fit, key=itemgetter(0)):
            if total + took < longest:
                asked.append(item)
                total += took
        if importing:
            code = ended(forked(partial(imported, mutant, session.config)), 30.0 * LONGEST)
        else:
            code = ended(forked(partial(tried, mutant, asked)), 10.0 + 4.0 * total) if asked else MISSED
        name = os.path.relpath(mutant.path, session.config.rootpath)
        counts.setdefault(str(Path(name).parent), Counter())[code] += 1
        if code == MISSED:
            say(f"missed by {len(asked)} tests: {name}:{mutant.lines.start}: {mutant.text}")
    PLACE.unlink(missing_ok=True)
    for name, count in sorted(counts.items()):
        say(f"{name}: {count[NOTICED]} of {count[NOTICED] + count[MISSED]}")
    found = sum(counts.values(), Counter())
    say(f"all: {found[NOTICED]} of {found[NOTICED] + found[MISSED]}")
    return True
