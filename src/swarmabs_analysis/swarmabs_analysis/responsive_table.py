"""Tables of numbers for terminals of any width."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

_UNLIMITED = 1000


class FittingTable(Table):
    """A table that is never squeezed: where it does not fit, a line of words per row, which may break between words.

    Columns that are not justified to the right name the row; the others have its numbers.
    """

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the table, or the lines in its place."""
        needed = Measurement.get(console, options.update(max_width=_UNLIMITED), self).maximum
        if needed <= options.max_width:
            yield from super().__rich_console__(console, options)
            return
        names = [column for column in self.columns if column.justify != "right"]
        numbers = [column for column in self.columns if column.justify == "right"]
        rows = list(zip(*(column.cells for column in (*names, *numbers)), strict=True))
        for row in rows:
            values = zip(numbers, row[len(names) :], strict=True)
            told = ", ".join(f"{column.header} {value}" for column, value in values if value)
            yield Text(" ".join(map(str, row[: len(names)])) + (f": {told}" if told else ""), overflow="fold")
