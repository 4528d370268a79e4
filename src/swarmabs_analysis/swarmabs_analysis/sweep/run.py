"""Running a sweep: from the cases to the folder with the results."""

from __future__ import annotations

import io
import json
import time
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow.csv import write_csv

from swarmabs_analysis.sweep.evaluate import OUTCOMES
from swarmabs_core.errors import RunError
from swarmabs_run.ending import terminable

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Callable, Mapping, Sequence

    from swarmabs_analysis.sweep.executor import Executor
    from swarmabs_analysis.sweep.folder import SweepFolder
    from swarmabs_analysis.sweep.study import Study


_KINDS = {
    **dict.fromkeys(("case", "seed", "messages"), pa.int64()),
    **dict.fromkeys(("status", "outcome", "reason", "digest"), pa.string()),
    **dict.fromkeys(("in_printed_estimate", "in_corrected_estimate"), pa.bool_()),
}
"""Types of columns that do not hold floating-point numbers."""


def run_sweep(
    study: Study, folder: SweepFolder, executor: Executor, on_progress: Callable[[Counter[str]], None]
) -> dict[str, Any]:
    """Compute the cases that are not finished yet, write table, pictures and summary, and return the summary.

    Its ``status`` is ok, failed or interrupted; in the latter cases the finished cases are kept, and another start
    continues from there. The folder must be locked; `on_progress` receives the counts of the outcomes, after each case
    and periodically.
    """
    begun = time.monotonic()
    before = len(folder.rows)
    status, reason, computing = "ok", None, None
    try:
        with terminable():
            on_progress(folder.outcomes)
            tasks = (study.task(index) for index in range(study.sweep.count) if index not in folder.rows)
            if before < study.sweep.count:
                for row in executor.compute(tasks, lambda: on_progress(folder.outcomes)):
                    folder.add(row)
                    on_progress(folder.outcomes)
            computing = time.monotonic() - begun
            from swarmabs_analysis.sweep.picture import pictures  # noqa: PLC0415 - Matplotlib need not delay the cases

            results = results_table(study, folder.rows)
            folder.write_whole(folder.table, csv(results))
            folder.write_whole(folder.results, parquet(results))
            for name, content in pictures(study, folder.rows).items():
                folder.write_whole(folder.path / name, content)
    except RunError as error:
        status, reason = "failed", str(error)
    except KeyboardInterrupt:
        status, reason = "interrupted", "interrupted; continue with --resume"
    finally:
        executor.close()
    folder.read()  # an interrupt may come between writing a row and counting it
    wall_time = time.monotonic() - begun
    computed = len(folder.rows) - before
    summary = {
        "sweep": study.sweep.name,
        "cases": study.sweep.count,
        "finished": len(folder.rows),
        "outcomes": {name: folder.outcomes[name] for name in OUTCOMES},
        "engine": executor.description,
        "wall_time": round(wall_time, 3),
        "computed": computed,
        "cases_per_second": round(computed / (computing or wall_time), 3) if computed else None,
        "status": status,
        "reason": reason,
    }
    folder.write_whole(folder.summary, (json.dumps(summary, indent=2) + "\n").encode())
    if status == "ok":
        folder.journal.unlink()
    return summary


def results_table(study: Study, rows: Mapping[int, Mapping[str, Any]]) -> Any:
    """Return the results as a table of Arrow: one row per case in order; all cases must be finished.

    Columns are ``case``, the parameters by their paths, the results, ``status``, ``outcome``, ``reason``, ``seed`` and
    ``digest``. A parameter whose values are neither all numbers nor all strings is written as JSON. The metadata
    contains the sweep and its scenario.
    """
    cases = list(study.cases())
    found = [{**rows[case.index], "case": case.index, "seed": case.seed} for case in cases]

    def column(name: str) -> Any:
        return pa.array([row.get(name) for row in found], _KINDS.get(name, pa.float64()))

    columns = {"case": column("case")}
    columns |= {path: _parameter([case.values[path] for case in cases]) for path in study.sweep.parameters}
    names = (*study.sweep.results, "status", "outcome", "reason", "seed", "digest")
    columns |= {name: column(name) for name in names}
    described = {"swarmabs.sweep": study.sweep_text, "swarmabs.scenario": study.scenario}
    return pa.table(columns).replace_schema_metadata(described)


def parquet(table: Any) -> bytes:
    """Return ``results.parquet``; equal tables give equal bytes."""
    file = io.BytesIO()
    pq.write_table(table, file, compression="zstd")
    return file.getvalue()


def csv(table: Any) -> bytes:
    """Return ``results.csv``: a line of names, then one per case; numbers with every digit, null as an empty field."""
    file = io.BytesIO()
    write_csv(table, file)
    return file.getvalue()


def _parameter(values: Sequence[Any]) -> Any:
    """Return the column of a parameter in the simplest type that fits all its values."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int} and all(abs(value) < 2**63 for value in values if value is not None):
        return pa.array(values, pa.int64())
    if kinds and kinds <= {int, float}:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    if kinds in ({bool}, {str}):
        return pa.array(values)
    return pa.array([json.dumps(value) for value in values], pa.string())
