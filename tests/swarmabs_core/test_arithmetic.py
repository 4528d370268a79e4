"""Nothing that differs between machines or versions of Python computes recorded numbers."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.processes import ROOT

RECORDED = (
    *sorted((ROOT / "src/swarmabs_core/swarmabs_core").rglob("*.py")),
    *sorted(path for folder in ("run", "config") for path in (ROOT / f"src/swarmabs_{folder}").rglob("*.py")),
    ROOT / "src/swarmabs_analysis/swarmabs_analysis/verification/recomputation.py",
    ROOT / "src/swarmabs_analysis/swarmabs_analysis/verification/realtime_nodes.py",
    ROOT / "src/swarmabs_bag/swarmabs_bag/run/figures.py",
    *sorted(path for path in (ROOT / "examples").glob("*/*.py") if path.name not in {"picture.py", "run.py"}),
)
"""Where recorded numbers arise, in the project and in its examples."""
EXACT = {
    *("copysign", "fabs", "floor", "ceil", "trunc", "frexp", "ldexp", "isqrt", "isfinite", "isinf", "isnan", "inf"),
    *("nan", "pi", "fsum", "sqrt", "remainder", "fmod", "prod", "gcd"),
}
"""Of `math`, what IEEE 754 or Python defines to the last bit."""
NUMPY = {
    *("sin", "cos", "tan", "tanh", "sinh", "cosh", "exp", "expm1", "exp2", "log", "log1p", "log2", "log10", "arctan"),
    *(
        "arctan2",
        "arcsin",
        "arccos",
        "power",
        "float_power",
        "hypot",
        "cbrt",
        "sum",
        "nansum",
        "mean",
        "average",
        "std",
    ),
    *("var", "cumsum", "dot", "vdot", "inner", "matmul", "einsum", "tensordot", "linalg", "trapezoid", "interp"),
    *("polyfit", "polyval", "convolve", "random", "fft"),
}
"""Of numpy, what depends on the processor, or on an order of addition that numpy chooses."""
ALLOWED = {
    "src/swarmabs_core/swarmabs_core/theory/": "checks of a scenario, which nothing records",
    "src/swarmabs_core/swarmabs_core/elementary.py": "starts an iteration whose result does not depend on it",
    "src/swarmabs_config/swarmabs_config/model/agents.py": "numbers of `random.Random`, which Python keeps the same",
    "src/swarmabs_config/swarmabs_config/scenario/checks.py": "squares in checks of a scenario",
    "src/swarmabs_core/swarmabs_core/systems/check.py": "a root in a check of a scenario",
    "examples/hardware_in_the_loop/": "simulated hardware in real time: what it measures is an input of the run",
    "examples/build_one/calibrate.py": "constants of hardware from measurements, by hand",
    "examples/mujoco/": "a physical world, whose motion nothing records",
}
"""Places that may use what is forbidden, with the reasons."""
FORBIDDEN_MODULES = {"cmath", "statistics", "random", "scipy", "decimal"}
COUNTED = {
    *("fault.late(draw)", "f.clock_offset()", "_has_changed(places, standby)", "count", "span.count"),
    "span.last - span.first + 1",
}
"""Terms that are integers, as only their definitions tell."""


def violations(tree: ast.AST) -> Iterator[str]:
    """Yield what a module uses that does not give the same bits everywhere, with its line."""
    for node in ast.walk(tree):
        where = f"line {getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.ImportFrom) and node.module == "math":
            yield from (f"{where}: math.{name.name}" for name in node.names if name.name not in EXACT)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in FORBIDDEN_MODULES:
            yield f"{where}: {node.module}"
        elif isinstance(node, ast.Import):
            names = {alias.name.partition(".")[0] for alias in node.names}
            yield from (f"{where}: {name}" for name in sorted(names & FORBIDDEN_MODULES))
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id == "math" and node.attr not in EXACT:
                yield f"{where}: math.{node.attr}"
            if node.value.id in {"np", "numpy"} and node.attr in NUMPY:
                yield f"{where}: numpy.{node.attr}"
        elif isinstance(node, (ast.BinOp, ast.Call)) and _rounds(node):
            yield f"{where}: {ast.unparse(node)}"


def _rounds(node: ast.BinOp | ast.Call) -> bool:
    """Return whether a power, a matrix product or a sum of numbers is computed."""
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.MatMult) or (isinstance(node.op, ast.Pow) and not _whole(node.left))
    name = ast.unparse(node.func)
    return name == "pow" or (name == "sum" and not _counts(node.args[0]))


def _whole(node: ast.expr) -> bool:
    """Return whether an expression is an integer or 2.0, whose powers are exact."""
    if isinstance(node, ast.UnaryOp):
        node = node.operand
    return isinstance(node, ast.Constant) and (isinstance(node.value, int) or node.value == 2.0)


def _counts(terms: ast.expr) -> bool:
    """Return whether the terms of a sum are counted things: comparisons, ones, lengths, steps."""
    if isinstance(terms, ast.Call) and ast.unparse(terms.func) == "map":
        return ast.unparse(terms.args[0]) == "len"
    if not isinstance(terms, ast.GeneratorExp):
        return False
    counted = (ast.Compare, ast.Constant, ast.BoolOp)
    text = ast.unparse(terms.elt)
    if text in COUNTED:
        return True
    return isinstance(terms.elt, counted) or text.endswith((".size", ".count")) or text.startswith(("len(", "bool("))


@pytest.mark.parametrize("path", RECORDED, ids=lambda path: str(path.relative_to(ROOT)))
def test_recorded_numbers_are_computed_by_what_is_the_same_everywhere(path: Path) -> None:
    name = path.relative_to(ROOT).as_posix()
    if any(name.startswith(allowed) for allowed in ALLOWED):
        return
    assert list(violations(ast.parse(path.read_text(encoding="utf-8")))) == []


@pytest.mark.parametrize(
    "text",
    [
        "from math import sin",
        "import math\nmath.exp(1.0)",
        "from statistics import NormalDist",
        "import numpy as np\nnp.sum([1.0])",
        "x ** 2",
        "x @ y",
        "sum(a * b for a, b in c)",
        "sum(masses)",
        "pow(x, 2)",
    ],
)
def test_what_differs_is_found(text: str) -> None:
    assert list(violations(ast.parse(text)))


def test_every_exception_is_needed() -> None:
    for allowed in ALLOWED:
        paths = [path for path in RECORDED if path.relative_to(ROOT).as_posix().startswith(allowed)]
        assert any(list(violations(ast.parse(path.read_text(encoding="utf-8")))) for path in paths), allowed
