"""How well this host's clock agrees with that of its time source, asked of chrony, linuxptp or systemd."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass

_PATIENCE = 5.0
_CHRONY_FIELDS = 14


@dataclass(frozen=True, slots=True)
class ClockState:
    """What is known of the clock.

    Parameters
    ----------
    source : str
        Who says so.
    synchronised : bool
        Whether the clock follows a time source.
    bound : float, optional
        Largest error of the clock, s, if it is known.
    """

    source: str
    synchronised: bool
    bound: float | None = None


def clock_state() -> ClockState | None:
    """Ask the first of chrony, linuxptp and systemd that answers; None if none does."""
    for command, read in (
        (("chronyc", "-n", "-c", "tracking"), read_chrony),
        (("pmc", "-u", "-b", "0", "GET TIME_STATUS_NP"), read_pmc),
        (("timedatectl", "show", "--property=NTPSynchronized", "--value"), read_timedatectl),
    ):
        if (text := answer(*command)) and (state := read(text)):
            return state
    return None


def read_chrony(text: str) -> ClockState | None:
    """Read ``chronyc -c tracking``: the error is at most the offset, the dispersion and half the delay to the root."""
    fields = text.strip().split(",")
    if len(fields) != _CHRONY_FIELDS:
        return None
    try:
        offset, delay, dispersion = (float(fields[index]) for index in (4, 10, 11))
    except ValueError:
        return None
    if fields[13] == "Not synchronised":
        return ClockState("chrony", synchronised=False)
    return ClockState("chrony", synchronised=True, bound=abs(offset) + dispersion + delay / 2.0)


def read_pmc(text: str) -> ClockState | None:
    """Read what ptp4l says of itself: the offset from the master in ns, and whether there is one."""
    offset = re.search(r"\bmaster_offset\s+(-?\d+)\b", text)
    present = re.search(r"\bgmPresent\s+(\w+)", text)
    if offset is None or present is None:
        return None
    if present[1] != "true":
        return ClockState("PTP", synchronised=False)
    return ClockState("PTP", synchronised=True, bound=abs(int(offset[1])) * 1e-9)


def read_timedatectl(text: str) -> ClockState | None:
    """Read whether systemd knows the clock as synchronised; how well it does not say."""
    answer = text.strip()
    return ClockState("systemd", synchronised=answer == "yes") if answer in {"yes", "no"} else None


def answer(*command: str) -> str:
    """Return what a program says; nothing if it is not there or fails."""
    if shutil.which(command[0]) is None:
        return ""
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_PATIENCE, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""
