"""Elementary functions against MPFR, which rounds correctly by specification: every bit counts, none may be wrong."""

import ast
import math
import random
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import NormalDist
from typing import Any

import gmpy2
import numpy as np
import pytest
from gmpy2 import mpfr

from swarmabs_core import elementary
from swarmabs_core.elementary import (
    _COS,
    _ERROR,
    _EXP,
    _EXPM1,
    _GRID,
    _GUARD,
    _HEAD,
    _LOG,
    _QUANTILE,
    _SIN,
    _TANH,
    NODES,
    Nodes,
    _decided,
    _exp,
    _expm1,
    _fixed,
    _log,
    _quantile,
    _sin_cos,
    _tanh,
    cos,
    exp,
    expm1,
    log,
    near,
    normal_quantile,
    sin,
    tanh,
)
from swarmabs_core.elementary_arrays import elementwise

Function = Callable[[float], float]

FUNCTIONS: dict[str, Function] = {"sin": sin, "cos": cos, "exp": exp, "expm1": expm1, "tanh": tanh, "log": log}
IN_INTEGERS: dict[Function, Callable[[float, int], tuple[int, int]]] = {
    sin: lambda x, p: (_sin_cos(x, p)[0], p),
    cos: lambda x, p: (_sin_cos(x, p)[1], p),
    exp: lambda x, p: _exp(_fixed(x, p + _GUARD), p),
    expm1: _expm1,
    tanh: lambda x, p: (_tanh(x, p), p),
    log: lambda x, p: (_log(x, p), p),
}
TINY, SUBNORMAL, NORMAL, LARGEST = (
    2.0**-1074,
    math.nextafter(2.0**-1022, 0.0),
    2.0**-1022,
    math.nextafter(math.inf, 0.0),
)
HARD = Path(__file__).with_name("hard_cases.txt")
STEP = 2.0**-8

RANGES: dict[str, Callable[[random.Random], float]] = {
    "all doubles": lambda draw: struct.unpack("<d", draw.randbytes(8))[0],
    "order 1": lambda draw: draw.uniform(-1.0, 1.0),
    "order 10": lambda draw: draw.uniform(-10.0, 10.0),
    "order 100": lambda draw: draw.uniform(-100.0, 100.0),
    "exponents of exp": lambda draw: draw.uniform(-750.0, 720.0),
    "all usual exponents": lambda draw: (
        draw.choice((-1.0, 1.0)) * draw.uniform(1.0, 2.0) * 2.0 ** draw.randrange(-70, 12)
    ),
}


def bits(x: float) -> bytes:
    """Return the bits of a double; all NaN are one."""
    return struct.pack("<d", math.nan if math.isnan(x) else x)


def wrong(name: str, arguments: Iterator[float] | list[float]) -> list[str]:
    """Return the arguments at which a function is not the double nearest to MPFR's value; of log, absolute values."""
    function, oracle = FUNCTIONS[name], getattr(gmpy2, name)
    found = []
    with gmpy2.context(gmpy2.ieee(64)):
        for argument in arguments:
            x = abs(argument) if name == "log" else argument
            if bits(function(x)) != bits(float(oracle(mpfr(x)))):
                found.append(x.hex())
    return found


def hard_cases(name: str) -> list[float]:
    lines = (line.split() for line in HARD.read_text(encoding="ascii").splitlines() if not line.startswith("#"))
    return [float.fromhex(number) for function, number in lines if function == name]


def around(x: float) -> list[float]:
    """Return a number and its neighbours, of both signs."""
    found = (math.nextafter(x, -math.inf), x, math.nextafter(x, math.inf))
    return [*found, *(-y for y in found)]


@pytest.mark.parametrize("drawn", RANGES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_random_arguments(name: str, drawn: str) -> None:
    draw = random.Random(f"{name} {drawn}")
    assert wrong(name, [RANGES[drawn](draw) for _ in range(8000)]) == []


@pytest.mark.full
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("drawn", RANGES)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_millions_of_random_arguments(name: str, drawn: str) -> None:
    draw = random.Random(f"more {name} {drawn}")
    assert wrong(name, (RANGES[drawn](draw) for _ in range(150_000))) == []


@pytest.mark.parametrize("name", FUNCTIONS)
def test_published_hard_cases(name: str) -> None:
    cases = hard_cases(name)
    assert len(cases) == 300
    assert wrong(name, [y for x in cases for y in around(x)]) == []


@pytest.mark.parametrize("name", FUNCTIONS)
def test_neighbours_of_nodes_of_halves_between_them_of_periods_and_of_limits(name: str) -> None:
    """Where one formula ends and the next begins."""
    draw = random.Random(name)
    nodes = [draw.randrange(-21 * 256, 21 * 256) * STEP for _ in range(1500)] + [n * STEP for n in range(-4, 5)]
    nodes += [4.0, 20.0, 1.0, 0.75, 1.5]
    periods = [
        n * period for n in (1, 2, 3, 7, 100, 651, 652, 1022, 1023, 1024) for period in (math.pi / 4, math.log(2.0) / 2)
    ]
    limits = [50.0, 706.0, 707.0, 709.0, 710.0, 745.5, 746.0, 1024.0, 2.0**16, 2.0**53]
    limits += [2.0**n for n in (-1022, -1021, -80, -60, *range(-56, -51), *range(-29, -25), -10, -9, -8, 43, 44, 1023)]
    places = [*nodes, *(c + STEP / 2 for c in nodes), *periods, *limits]
    assert wrong(name, [y for x in places for y in around(x)]) == []


@pytest.mark.parametrize("name", FUNCTIONS)
def test_ends_of_the_range_of_results(name: str) -> None:
    """Overflow, underflow, subnormal results and arguments, with their neighbours."""
    ends = [
        math.log(LARGEST),
        math.log(NORMAL),
        math.log(TINY),
        math.log(TINY) - math.log(2.0),
        36.7,
        37.5,
        19.06,
        18.7,
    ]
    draw = random.Random(name)
    subnormal = [-draw.uniform(708.0, 746.0) for _ in range(500)] + [
        draw.randrange(1, 2**52) * TINY for _ in range(500)
    ]
    places = [*ends, *subnormal, 0.0, TINY, 2 * TINY, SUBNORMAL, NORMAL, LARGEST, 1.0]
    assert wrong(name, [y for x in places for y in around(x)]) == []


@pytest.mark.parametrize(
    ("function", "x", "value"),
    [
        *((function, x, x) for function in (sin, expm1, tanh) for x in (0.0, -0.0, TINY, -TINY, SUBNORMAL, NORMAL)),
        *((function, x, 1.0) for function in (cos, exp) for x in (0.0, -0.0, TINY, -TINY)),
        *((function, math.nan, math.nan) for function in FUNCTIONS.values()),
        *((function, x, math.nan) for function in (sin, cos) for x in (math.inf, -math.inf)),
        *((exp, x, y) for x, y in ((math.inf, math.inf), (-math.inf, 0.0), (1000.0, math.inf), (-1000.0, 0.0))),
        *((expm1, x, y) for x, y in ((math.inf, math.inf), (-math.inf, -1.0), (LARGEST, math.inf), (-LARGEST, -1.0))),
        *((tanh, x, y) for x, y in ((math.inf, 1.0), (-math.inf, -1.0), (LARGEST, 1.0), (-LARGEST, -1.0))),
        *((log, x, y) for x, y in ((math.inf, math.inf), (0.0, -math.inf), (-0.0, -math.inf), (1.0, 0.0))),
        *((log, x, math.nan) for x in (-TINY, -1.0, -math.inf)),
    ],
)
def test_special_values(function: Function, x: float, value: float) -> None:
    assert bits(function(x)) == bits(value)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_integers_alone_give_the_same_bits(name: str) -> None:
    draw = random.Random(name)
    function, drawn = FUNCTIONS[name], RANGES["all usual exponents"]
    for _ in range(1500):
        x = abs(drawn(draw)) if name == "log" else drawn(draw)
        if 2.0**-53 < abs(x) < (20.0 if name == "tanh" else 700.0):
            assert bits(function(x)) == bits(_decided(lambda p, x=x: IN_INTEGERS[function](x, p)))  # type: ignore[misc]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_integers_keep_their_bound_and_take_more_bits_until_they_decide(name: str) -> None:
    """Few bits at first, which leave hard cases undecided."""
    function, oracle = IN_INTEGERS[FUNCTIONS[name]], getattr(gmpy2, name)
    cases = [x for x in hard_cases(name) if 2.0**-7 < abs(x) < (16.0 if name == "tanh" else 700.0)]
    assert len(cases) > 100
    with gmpy2.context(gmpy2.ieee(64)):
        expected = [float(oracle(mpfr(x))) for x in cases]
    for p in (52, 56, 64):
        assert [_decided(lambda bits, x=x: function(x, bits), p) for x in cases] == expected  # type: ignore[misc]
    with gmpy2.context(precision=800, emin=-4000, emax=4000):
        for x in cases:
            for p in (60, 130, 500):
                value, q = function(x, p)
                assert abs(value - oracle(mpfr(x)) * mpfr(2) ** q) < _ERROR


@pytest.mark.parametrize("odd", [sin, tanh])
def test_odd_and_even_functions(odd: Function) -> None:
    draw = random.Random(1)
    for _ in range(3000):
        x = RANGES["all usual exponents"](draw)
        assert bits(odd(-x)) == bits(-odd(x))
        assert bits(cos(-x)) == bits(cos(x))


def true_function(name: str, x: Any) -> Any:
    """Return a function of MPFR; the normal quantile at a probability below 1/2, by Newton's method from its double."""
    if name != "quantile":
        return getattr(gmpy2, name)(x)
    z = mpfr(normal_quantile(float(x)))
    for _ in range(3):
        density = gmpy2.exp(-z * z / 2) / gmpy2.sqrt(2 * gmpy2.const_pi())
        z -= (gmpy2.erfc(-z / gmpy2.sqrt(mpfr(2))) / 2 - mpfr(x)) / density
    return z


@pytest.mark.parametrize(
    ("name", "nodes", "unit", "low", "high"),
    [
        ("sin", _SIN, 1.0, -4.0, 4.0),
        ("cos", _COS, 1.0, -4.0, 4.0),
        ("tanh", _TANH, 1.0, -20.0, 20.0),
        ("expm1", _EXPM1, 1.0, -1.0, 1.0),
        ("exp", _EXP, 1.0, -0.36, 0.36),
        ("log", _LOG, 1.0, 0.75, 1.5),
        ("quantile", _QUANTILE[1], 0.25, 1.0, 2.0),
        ("quantile", _QUANTILE[4], 0.5**5, 1.0, 2.0),
        ("quantile", _QUANTILE[52], 0.5**53, 1.0, 2.0),
    ],
)
def test_sums_near_nodes_keep_their_bound(name: str, nodes: Nodes, unit: float, low: float, high: float) -> None:
    """At the edges of a node's range, where the error is largest, and within it; no bound is 10 times too large."""
    draw = random.Random(name)
    share = 0.0
    count = 400 if name != "quantile" else 60
    places = [draw.randrange(math.ceil(low / STEP), math.floor(high / STEP) + 1) * STEP for _ in range(count)]
    if name == "tanh":
        places += [n * STEP for n in range(-256, 257)]  # the seventh coefficient is largest at 0
    with gmpy2.context(precision=300, emin=-4000, emax=4000):
        for c in places:
            edges = (c - STEP / 2, math.nextafter(c - STEP / 2, c), math.nextafter(c + STEP / 2, c), c + STEP / 2)
            for x in (*edges, c + draw.uniform(-STEP / 2, STEP / 2)):
                if low <= x < high:
                    hi, lo, e = near(nodes, x, 0.0)
                    error = abs(mpfr(hi) + mpfr(lo) - true_function(name, mpfr(x) * mpfr(unit)))
                    assert error + mpfr(2.0**-53) * abs(mpfr(lo)) < mpfr(e), (c, x)
                    share = max(share, float(error / mpfr(e)))
    assert share > 0.1


@pytest.mark.parametrize("function", NODES)
def test_arrays_have_the_bits_of_their_numbers(function: Function) -> None:
    draw = random.Random(1)
    special = [0.0, -0.0, math.inf, -math.inf, math.nan, TINY, LARGEST, 4.0, 20.0, -20.0, -4.0 - STEP / 2, 20.0 + STEP]
    drawn = [number(draw) for number in RANGES.values() for _ in range(2000)]
    values = np.array([*special, *drawn]).reshape(4, -1)
    found = elementwise(function, values)
    assert found.shape == values.shape
    assert [bits(y) for y in found.ravel()] == [bits(function(x)) for x in values.ravel().tolist()]
    assert elementwise(function, np.array(0.5)) == function(0.5)
    assert elementwise(function, np.array([])).shape == (0,)
    assert elementwise(function, values[:, ::2]).tolist()[1] == found[1, ::2].tolist()


def misplaced(probability: float) -> bool:
    """Return whether the distribution at the halves next to a quantile does not enclose the probability."""
    z = normal_quantile(probability)
    lower, upper = ((mpfr(z) + mpfr(math.nextafter(z, end))) / 2 for end in (-math.inf, math.inf))
    root = gmpy2.sqrt(mpfr(2))
    if probability < 0.5:
        return not gmpy2.erfc(-lower / root) / 2 < probability < gmpy2.erfc(-upper / root) / 2
    return not gmpy2.erfc(lower / root) / 2 > 1.0 - probability > gmpy2.erfc(upper / root) / 2


def probabilities(draw: random.Random, number: int) -> Iterator[float]:
    """Yield the probabilities (n + 1/2) / 2**52 of noise, at both ends, in the middle, and of all magnitudes."""
    ends = [0, 1, 2, 2**51 - 2, 2**51 - 1]
    for n in (*ends, *(draw.getrandbits(52) for _ in range(number)), *(draw.getrandbits(k) for k in range(1, 52))):
        yield from ((n + 0.5) * 2.0**-52, (2**52 - 1 - n + 0.5) * 2.0**-52)


@pytest.mark.parametrize("number", [1500, pytest.param(100_000, marks=[pytest.mark.full, pytest.mark.timeout(600)])])
def test_normal_quantile(number: int) -> None:
    draw = random.Random(number)
    with gmpy2.context(precision=250, emin=-4000, emax=4000):
        assert [p for p in probabilities(draw, number) if misplaced(p)] == []
        assert [p for p in (2.0**-60, 1e-20, 1e-300, TINY, SUBNORMAL, 0.25, 0.75, 0.125) if misplaced(p)] == []
        # Neighbours of nodes, and of halves between them.
        places = [(1.0 + n * STEP / 2) / 2**k for k in (2, 3, 9) for n in (1, 2, 100, 101, 510, 511)]
        assert [p for place in places for p in around(place)[:3] if misplaced(p)] == []


def test_normal_quantile_in_integers_symmetric_and_at_special_values() -> None:
    draw = random.Random(1)
    for p in probabilities(draw, 100):
        q = min(p, 1.0 - p)
        below = _decided(lambda bits, q=q: _quantile(q, bits), 120)  # type: ignore[misc]
        assert normal_quantile(q) == below == -normal_quantile(1.0 - q)
    ends = (0.0, 0.5, 1.0, -0.1, 1.1, math.nan)
    values = (-math.inf, 0.0, math.inf, math.nan, math.nan, math.nan)
    assert [bits(normal_quantile(p)) for p in ends] == [bits(z) for z in values]


def test_the_start_of_the_quantile_does_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another mathematical library may start elsewhere."""
    cases = list(probabilities(random.Random(2), 20))
    before = [_quantile(min(p, 1.0 - p), 128) for p in cases]
    exact = NormalDist().inv_cdf
    rough = type("Rough", (), {"inv_cdf": lambda self, p: 1.001 * exact(p)})
    monkeypatch.setattr(elementary, "NormalDist", rough)
    after = [_quantile(min(p, 1.0 - p), 128) for p in cases]
    assert max(abs(x - y) for (x, _), (y, _) in zip(before, after, strict=True)) <= 2


def test_no_function_of_the_machine_is_used() -> None:
    """Only what is exact by definition comes from math; powers are of literals."""
    tree = ast.parse(Path(elementary.__file__).read_text(encoding="utf-8"))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module == "math"]
    assert {name.name for node in imports for name in node.names} == {"frexp", "inf", "isqrt", "nan"}
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Import)]
    powers = [node for node in ast.walk(tree) if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)]
    bases = {ast.unparse(node) for node in powers if ast.unparse(node.left) != "2.0"}
    assert bases == {"abs(w) ** 3"}  # of an integer
    assert [float.fromhex("0x1.8p44"), float.fromhex("0x1.8p22")] == [_GRID, _HEAD]
