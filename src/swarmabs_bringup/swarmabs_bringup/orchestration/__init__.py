"""Running a scenario as one process per node over DDS, in lockstep or in real time."""

from swarmabs_bringup.orchestration.lockstep_run import LockstepRun
from swarmabs_bringup.orchestration.progress import Outcome, Progress
from swarmabs_bringup.orchestration.realtime_run import RealtimeRun

__all__ = ["LockstepRun", "Outcome", "Progress", "RealtimeRun"]
