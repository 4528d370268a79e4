"""Errors of scenario files; untrusted content is shown safely in one line."""

from collections.abc import Mapping

from swarmabs_core.errors import InputError, joined

_LONGEST_VALUE = 60
_LONGEST_PART = 400


class ScenarioError(InputError):
    """A scenario is invalid.

    The text is one line, ``FILE:LINE: field: problem; remedy``, without unknown parts. `source` is the file or override
    (``--set a.b=v``) that caused the error, `field` a dotted path as in ``--set``, and `more` the number of further
    errors in the scenario.
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
        super().__init__(problem, remedy)
        self.source = source
        self.line = line
        self.field = field
        self.more = more
        self.args = (source, problem, remedy)

    def __str__(self) -> str:
        source, field, problem, remedy = (
            printable(shorten(text, _LONGEST_PART)) for text in (self.source, self.field, self.problem, self.remedy)
        )
        where = source if self.line is None else f"{source}:{self.line}"
        more = f" (+{self.more} more)" if self.more else ""
        return f"{joined(': '.join(filter(None, (where, field, problem))), remedy)}{more}"


def printable(text: str) -> str:
    """Escape every character of `text` that could break the line or control a terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def shorten(text: str, longest: int = _LONGEST_VALUE) -> str:
    """Return `text`, cut to `longest` characters with an ellipsis."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def describe(value: object) -> str:
    """Describe a value found in a scenario and its type, in a few words."""
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
