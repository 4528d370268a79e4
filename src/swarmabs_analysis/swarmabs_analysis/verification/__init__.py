"""Whether a recorded run is what its scenario and its messages lead to: recomputed, compared bit for bit."""

from swarmabs_analysis.verification.comparison import Difference
from swarmabs_analysis.verification.verifier import Ending, Verification

__all__ = ["Difference", "Ending", "Verification"]
