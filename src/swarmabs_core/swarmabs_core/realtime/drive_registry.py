"""Where packages that bring a drive have imported it from; new ones import from `swarmabs_core.realtime.drives`."""

from swarmabs_core.realtime.drives import DRIVES, SIMULATED, TOPIC, Body, DriveType

__all__ = ["DRIVES", "SIMULATED", "TOPIC", "Body", "DriveType"]
