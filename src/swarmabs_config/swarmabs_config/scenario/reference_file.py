"""The CSV file of a reference trajectory, which its rows replace when a scenario is loaded."""

import csv
import math
from functools import partial
from pathlib import Path

from swarmabs_config.model.controllers import MOST_ROWS
from swarmabs_config.model.errors import ScenarioError, show
from swarmabs_config.model.fields import LARGEST
from swarmabs_core.declaration import LONGEST_TIME
from swarmabs_core.plant import STEEPEST
from swarmabs_core.trajectory import SHORTEST

from .text_file import read_text
from .yaml_tree import Entry, Node

HEADER = ["time", "angle"]


def with_rows(root: Node, folder: Path | None) -> Node:
    """Return the tree with ``controller.trajectory.file`` replaced by the rows of this CSV file, if there is one.

    The path is relative to the folder of the scenario's file; that of an override is relative to the current folder.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or has no header, a row that is not two numbers, times that do not increase, an
        angle beyond 1.5 rad, or too few or too many rows.
    """
    return root.changed(("controller", "trajectory"), partial(_with_rows, folder=folder))


def _with_rows(trajectory: Node, folder: Path | None) -> Node:
    entries = dict(trajectory.entries)
    if "type" not in entries or entries["type"].node.value != "csv" or "file" not in entries:
        return trajectory
    file = entries.pop("file").node
    base = Path() if file.mark.line is None else folder
    if not isinstance(file.value, str) or base is None:
        return trajectory
    times, angles = read_rows(base / file.value)
    if entries.keys() & {"times", "angles"}:
        return trajectory
    for name, values in (("times", times), ("angles", angles)):
        rows = Node(tuple(Node(value, file.mark) for value in values), file.mark, 1 + len(values), 1)
        entries[name] = Entry(file.mark, rows)
    return Node(entries, trajectory.mark)


def read_rows(path: Path) -> tuple[list[float], list[float]]:
    """Return the times (s) and angles (rad) of a CSV file with the header ``time,angle``.

    Raises
    ------
    ScenarioError
        See `with_rows`; it names the file and the line.
    """
    source = str(path)
    reader = csv.reader(read_text(path, "trajectory", "CSV").splitlines(), strict=True)
    times: list[float] = []
    angles: list[float] = []
    try:
        header = next(reader, [])
        if [cell.strip() for cell in header] != HEADER:
            raise ScenarioError(source, "no header time,angle", "make 'time,angle' the first line", line=1)
        for row in reader:
            if not row:
                continue
            time, angle = _row(row, source, reader.line_num)
            if times and not time - times[-1] >= SHORTEST:
                raise ScenarioError(
                    source,
                    f"time {time!r} s follows {times[-1]!r} s",
                    f"make each time at least {SHORTEST} s later than the one before",
                    line=reader.line_num,
                    field="time",
                )
            times.append(time)
            angles.append(angle)
    except csv.Error as exc:
        raise ScenarioError(source, f"not CSV: {exc}", "give two numbers in each line", line=reader.line_num) from exc
    if not 2 <= len(times) <= MOST_ROWS:
        raise ScenarioError(source, f"{len(times)} rows", f"give 2 to {MOST_ROWS} rows of time,angle")
    return times, angles


def _row(row: list[str], source: str, line: int) -> tuple[float, float]:
    if len(row) != len(HEADER):
        raise ScenarioError(source, f"{len(row)} values", "give two numbers, time in s and angle in rad", line=line)
    numbers = []
    for name, text in zip(HEADER, row, strict=True):
        try:
            number = float(text) + 0.0
        except ValueError:
            number = math.nan
        if not abs(number) <= LARGEST:
            raise ScenarioError(source, f"{show(text)} is not a number", "give a finite number", line=line, field=name)
        numbers.append(number)
    time, angle = numbers
    if not 0.0 <= time <= LONGEST_TIME:
        raise ScenarioError(
            source, f"{time!r} s is out of range", f"give 0 to {LONGEST_TIME} s", line=line, field="time"
        )
    if not abs(angle) < STEEPEST:
        raise ScenarioError(
            source,
            f"{angle!r} rad is out of range",
            f"stay within +-{STEEPEST} rad, in radians and not degrees",
            line=line,
            field="angle",
        )
    return time, angle
