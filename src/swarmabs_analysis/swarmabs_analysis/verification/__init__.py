"""Whether a recorded run is what its scenario and its messages lead to: recomputed, compared bit for bit."""

from swarmabs_analysis.verification.base import Ending, Verification
from swarmabs_analysis.verification.lockstep import LockstepVerification
from swarmabs_analysis.verification.realtime import RealtimeVerification

__all__ = ["Ending", "LockstepVerification", "RealtimeVerification", "Verification"]
