"""Whether a recorded run is what its scenario and its messages lead to: recomputed, compared bit for bit."""

from swarmabs_core.verification.comparison import Difference
from swarmabs_core.verification.verifier import Ending, Verification

__all__ = ["Difference", "Ending", "Verification"]
