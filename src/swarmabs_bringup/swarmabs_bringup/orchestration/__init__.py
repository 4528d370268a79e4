"""Running a scenario as one process per node, in lockstep over DDS."""

from swarmabs_bringup.orchestration.lockstep_run import LockstepRun
from swarmabs_bringup.orchestration.progress import Outcome, Progress

__all__ = ["LockstepRun", "Outcome", "Progress"]
