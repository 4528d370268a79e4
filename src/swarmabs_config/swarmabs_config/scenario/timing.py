"""Time as exact integers: the decimals of a scenario in nanoseconds, and fault times in steps."""

from fractions import Fraction
from typing import Annotated, TypeAlias

from pydantic import AfterValidator, Field

from swarmabs_core.declaration import LONGEST_TIME

from .fields import problem

NANOSECONDS = 10**9


def to_nanoseconds(seconds: float) -> int:
    """Return `seconds` (s) as an integer number of nanoseconds, exactly as its decimal text says.

    Raises
    ------
    ValueError
        If the decimal is not a whole number of nanoseconds.
    """
    exact = Fraction(repr(seconds)) * NANOSECONDS
    if exact.denominator != 1:
        raise ValueError(f"{seconds!r} s is not a whole number of nanoseconds")
    return exact.numerator


def nearest_step(at: float, step_ns: int) -> int:
    """Return round(at/step): `at` in s, `step_ns` in ns, the ratio taken exactly, ties to the even step."""
    return round(Fraction(repr(at)) * NANOSECONDS / step_ns)


def _whole_nanoseconds(seconds: float) -> float:
    try:
        to_nanoseconds(seconds)
    except ValueError as exc:
        raise problem(str(exc), "give at most nine decimals, e.g. 0.01") from None
    return seconds + 0.0


WholeNanoseconds = AfterValidator(_whole_nanoseconds)
Duration: TypeAlias = Annotated[float, Field(gt=0, le=LONGEST_TIME), WholeNanoseconds]
"""A positive time in s that is a whole number of nanoseconds."""
