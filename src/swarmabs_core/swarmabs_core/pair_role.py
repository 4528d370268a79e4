"""What one of a pair of coordinators is called and does, in the words of diagnostics, logs and views."""

from enum import Enum

STANDBY_SUFFIX = "_standby"
"""What the name of a standby coordinator's node ends with."""
RECORDS = "records"
"""What both of a pair of recorders do; `PairRole` tells what one of any other pair does."""
ROLE, ROLE_FOR = "role", "role for, s"
"""The values of a health status that say what one of a pair does, and for how long."""


class PairRole(Enum):
    """What one of a pair does."""

    LISTENING = "listens"
    FOLLOWING = "stands by"
    LEADING = "leads"


def role_values(rank: str, role: str, seconds: float) -> tuple[tuple[str, str], ...]:
    """Return the values of one of a pair for a health status: what it is, what it does, and for how long (s)."""
    return ("pair", rank), (ROLE, role), (ROLE_FOR, f"{max(0.0, seconds):.0f}")
