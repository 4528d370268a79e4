"""What the orchestrator tells the launcher when it starts it."""

CROWDED = "--crowded"
"""There are many more processes than cores."""
REALTIME = "--realtime"
"""The nodes run in real time."""
