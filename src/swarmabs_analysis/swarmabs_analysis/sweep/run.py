"""Running a sweep: from the cases to the folder with the results."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING

from swarmabs_analysis.sweep.evaluate import OUTCOMES
from swarmabs_analysis.sweep.table import table_files
from swarmabs_core.errors import RunError
from swarmabs_run.ending import terminable

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Callable

    from swarmabs_analysis.sweep.executor import Executor
    from swarmabs_analysis.sweep.folder import Summary, SweepFolder
    from swarmabs_analysis.sweep.study import Study


def run_sweep(
    study: Study, folder: SweepFolder, executor: Executor, on_progress: Callable[[Counter[str]], None]
) -> Summary:
    """Compute the cases that are not finished yet, write tables, pictures and summary, and return the summary.

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

            for name, content in {**table_files(study, folder.rows), **pictures(study, folder.rows)}.items():
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
    summary: Summary = {
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
