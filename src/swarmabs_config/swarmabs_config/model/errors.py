"""Errors of scenario files, and how hostile content is shown in their one line."""

from collections.abc import Mapping

from swarmabs_core.errors import InputError

_LONGEST_VALUE = 60
_LONGEST_PART = 400


class ScenarioError(InputError):
    """A scenario was refused.

    The text is one line, ``FILE:LINE: field: problem; remedy``, without the parts that are not known. The source is the
    file or the override (``--set a.b=v``) that caused it, `field` a dotted path as ``--set`` takes it, and `more` tells
    how many further errors the scenario has.
    """

    def __init__(
        self,
        source: str,
        problem: str,
        remedy: str,
        *,
        line: int | None = None,
        field: str = "",
        more: int = 0,
    ) -> None:
        self.source = source
        self.line = line
        self.field = field
        self.problem = problem
        self.remedy = remedy
        self.more = more
        super().__init__(source, problem, remedy)

    def __str__(self) -> str:
        source, field, problem, remedy = (
            printable(shorten(text, _LONGEST_PART)) for text in (self.source, self.field, self.problem, self.remedy)
        )
        where = source if self.line is None else f"{source}:{self.line}"
        more = f" (+{self.more} more)" if self.more else ""
        return f"{': '.join(part for part in (where, field, problem) if part)}; {remedy}{more}"


def printable(text: str) -> str:
    """Return `text` with every character that could leave the line or steer a terminal escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def shorten(text: str, longest: int = _LONGEST_VALUE) -> str:
    """Return `text`, cut to `longest` characters with an ellipsis."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def describe(value: object) -> str:
    """Name a value found in a scenario, with its type, in a few words."""
    if value is None:
        return "nothing (null)"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return f"the number {show(value)}" if not _is_huge(value) else show(value)
    if isinstance(value, str):
        return f"the text {show(value)}"
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    return f"an object of type {type(value).__name__}"


def show(value: object) -> str:
    """Return a short form of a scalar that fits into a line."""
    if isinstance(value, str):
        return f"'{printable(shorten(value))}'"
    if _is_huge(value):
        return f"a number of more than {_LONGEST_VALUE} digits"
    return printable(shorten(repr(value)))


def _is_huge(value: object) -> bool:
    return isinstance(value, int) and abs(value) >= 10**_LONGEST_VALUE
