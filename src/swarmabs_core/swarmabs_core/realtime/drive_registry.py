"""Former import path for packages that provide a drive; new packages import from `swarmabs_core.realtime.drives`."""

from swarmabs_core.realtime.drives import DRIVES, SIMULATED, TOPIC, Body, DriveType

__all__ = ["DRIVES", "SIMULATED", "TOPIC", "Body", "DriveType"]
