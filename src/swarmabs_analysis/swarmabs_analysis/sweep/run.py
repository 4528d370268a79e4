"""Carrying out a sweep: from the cases to the folder with the results."""

from __future__ import annotations

import json
import time
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.sweep.evaluate import OUTCOMES
from swarmabs_analysis.sweep.executor import Common, Task
from swarmabs_analysis.sweep.picture import pictures
from swarmabs_analysis.sweep.table import parquet
from swarmabs_core.errors import RunError
from swarmabs_run.interruption import terminable

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_analysis.sweep.executor import Executor
    from swarmabs_analysis.sweep.folder import SweepFolder
    from swarmabs_analysis.sweep.study import Study


@dataclass
class SweepProgress:
    """How far a sweep is: cases in all, finished, and how they ended."""

    cases: int
    done: int
    outcomes: Counter[str]


def run_sweep(
    study: Study, folder: SweepFolder, executor: Executor, on_progress: Callable[[SweepProgress], None]
) -> dict[str, Any]:
    """Compute the cases that are not finished yet, and write table, pictures and summary.

    Parameters
    ----------
    study : Study
        The sweep.
    folder : SweepFolder
        Its folder, taken.
    executor : Executor
        What computes the cases.
    on_progress : callable
        Told how far the sweep is, after each case and now and then.

    Returns
    -------
    dict
        The content of ``summary.json``; its ``status`` is ok, failed or interrupted. In the latter cases what is
        finished is kept, and another start goes on from there.
    """
    begun = time.monotonic()
    before = len(folder.rows)
    status, reason, computing = "ok", None, None
    try:
        with terminable():
            _compute(study, folder, executor, on_progress)
            computing = time.monotonic() - begun
            folder.write_whole(folder.results, parquet(study, folder.rows))
            for name, content in pictures(study, folder.rows).items():
                folder.write_whole(folder.path / name, content)
    except RunError as error:
        status, reason = "failed", str(error)
    except KeyboardInterrupt:
        status, reason = "interrupted", "interrupted; go on with --resume"
    finally:
        executor.close()
    folder.read()  # an interrupt comes at any moment, such as between writing a row and counting it
    wall_time = time.monotonic() - begun
    computed = len(folder.rows) - before
    outcomes = _outcomes(folder)
    summary = {
        "sweep": study.sweep.name,
        "cases": study.sweep.count,
        "finished": len(folder.rows),
        "outcomes": {name: outcomes[name] for name in OUTCOMES},
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


def _compute(
    study: Study, folder: SweepFolder, executor: Executor, on_progress: Callable[[SweepProgress], None]
) -> None:
    progress = SweepProgress(study.sweep.count, len(folder.rows), _outcomes(folder))
    on_progress(progress)
    if progress.done == progress.cases:
        return
    tasks = (Task(case.index, case.overrides()) for case in study.cases() if case.index not in folder.rows)
    common = Common(study.scenario, study.sweep.attraction.angle_max)
    for line in executor.compute(common, tasks, lambda: on_progress(progress)):
        row = folder.add(line)
        progress.done += 1
        progress.outcomes[row["outcome"]] += 1
        on_progress(progress)


def _outcomes(folder: SweepFolder) -> Counter[str]:
    return Counter(row["outcome"] for row in folder.rows.values())
