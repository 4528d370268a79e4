"""Carrying out a sweep: from the cases to the folder with the results."""

from __future__ import annotations

import json
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from swarmabs_bringup.simulate import terminable
from swarmabs_bringup.sweep.engine import Common, Task
from swarmabs_bringup.sweep.evaluate import OUTCOMES
from swarmabs_bringup.sweep.picture import pictures
from swarmabs_bringup.sweep.table import parquet
from swarmabs_core.errors import RunError

if TYPE_CHECKING:
    from collections.abc import Callable

    from swarmabs_bringup.sweep.engine import Engine
    from swarmabs_bringup.sweep.folder import SweepFolder
    from swarmabs_bringup.sweep.study import Study


@dataclass
class SweepProgress:
    """How far a sweep is: cases in all, finished, finished by this start, and how they ended."""

    cases: int
    done: int
    new: int = 0
    outcomes: Counter[str] = field(default_factory=Counter)


def run_sweep(
    study: Study, folder: SweepFolder, engine: Engine, on_progress: Callable[[SweepProgress], None]
) -> dict[str, Any]:
    """Compute the cases that are not finished yet, and write table, pictures and summary.

    Parameters
    ----------
    study : Study
        The sweep.
    folder : SweepFolder
        Its folder, taken.
    engine : Engine
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
    outcomes = Counter(row["outcome"] for row in folder.rows.values())
    progress = SweepProgress(study.sweep.count, len(folder.rows), outcomes=outcomes)
    status, reason = "ok", None
    try:
        with terminable():
            _compute(study, folder, engine, lambda: on_progress(progress), progress)
            computing = time.monotonic() - begun
            folder.write_whole(folder.results, parquet(study, folder.rows))
            for name, content in pictures(study, folder.rows).items():
                folder.write_whole(folder.path / name, content)
    except RunError as error:
        status, reason, computing = "failed", str(error), time.monotonic() - begun
    except KeyboardInterrupt:
        status, reason, computing = "interrupted", "interrupted; go on with --resume", time.monotonic() - begun
    finally:
        engine.close()
    summary = {
        "sweep": study.sweep.name,
        "cases": progress.cases,
        "finished": progress.done,
        "outcomes": {name: progress.outcomes[name] for name in OUTCOMES},
        "engine": engine.description,
        "wall_time": round(time.monotonic() - begun, 3),
        "computed": progress.new,
        "cases_per_second": round(progress.new / computing, 3) if progress.new else None,
        "status": status,
        "reason": reason,
    }
    folder.write_whole(folder.summary, (json.dumps(summary, indent=2) + "\n").encode())
    if status == "ok":
        folder.journal.unlink()
    return summary


def _compute(
    study: Study, folder: SweepFolder, engine: Engine, tell: Callable[[], None], progress: SweepProgress
) -> None:
    tasks = (Task(case.index, case.overrides()) for case in study.cases() if case.index not in folder.rows)
    common = Common(study.scenario, study.sweep.attraction.angle_max)
    tell()
    if progress.done == progress.cases:
        return
    for line in engine.compute(common, tasks, tell):
        row = folder.add(line)
        progress.done += 1
        progress.new += 1
        progress.outcomes[row["outcome"]] += 1
        tell()
