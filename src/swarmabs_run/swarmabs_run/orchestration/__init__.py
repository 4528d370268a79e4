"""Running a scenario as one process per node over DDS, in lockstep or in real time."""

from swarmabs_run.orchestration.lockstep_run import LockstepRun
from swarmabs_run.orchestration.progress import Outcome, Progress
from swarmabs_run.orchestration.realtime_run import RealtimeRun

__all__ = ["LockstepRun", "Outcome", "Progress", "RealtimeRun"]
