"""A run that says how far it is, until it ends or is killed; started by the tests beside it.

Usage: observed_run.py FOLDER STEPS_FILE OVERRIDE...

For every report of the recorder that arrives it appends the time and the number of steps recorded to a file.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

from swarmabs_bag.run_folder import Split, new_run_folder
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.run import Progress, RunOptions


def main() -> int:
    folder, steps, *overrides = sys.argv[1:]
    scenario = find_scenario("pd_het_4", overrides).resolved()
    log = os.open(steps, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def say(progress: Progress) -> None:
        if progress.phase == "running" and progress.angle is not None:  # something is recorded
            os.write(log, f"{time.monotonic():.6f} {progress.step}\n".encode())

    options = RunOptions(on_progress=say, split=Split(nanoseconds=20 * 10**9))
    outcome = LockstepRun(scenario, new_run_folder(Path(folder)), options).run()
    return 0 if outcome.status == "ok" else 1


if __name__ == "__main__":
    sys.exit(main())
