"""Errors of writing and reading bags."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from pathlib import Path

# By the errors that are those of the disk or the machine, and not of what was named.
REMEDIES = {
    errno.ENOSPC: "free space on that disk, or record to another one with -o",
    errno.EDQUOT: "free some of your quota, or record to another disk with -o",
    errno.EFBIG: "raise the limit on file sizes (ulimit -f), or record for a shorter time",
    errno.EIO: "the disk reports a defect (see dmesg): record to another one with -o",
    errno.EMFILE: "raise the limit on open files (ulimit -n)",
    errno.ENFILE: "the machine has no free file descriptor: end other programs, or raise fs.file-max",
}

CONVERT = "convert it with ros2 bag convert (docs/how-to/ros.md)"
"""What to do about a bag of rosbag2 in a form that is not read."""


def remedy(cause: OSError) -> str:
    """Return what to do about an error of a file."""
    return REMEDIES.get(cause.errno or 0, "check that disk, or record to another one with -o")


def repair_command(bag: Path | str) -> str:
    """Return what to do about a damaged bag."""
    return f"repair it with ./scripts/swarm repair {bag}"


class BagFolderError(InputError):
    """The folder for a new bag cannot be used; nothing was written."""


class UnknownTypeError(InputError):
    """The definition of a message type is not installed, or not known."""


class BagWriteError(RunError):
    """Writing a bag failed; what was written before is kept."""

    def __init__(self, path: Path, cause: OSError) -> None:
        super().__init__(f"cannot write {path}: {cause.strerror or cause}; {remedy(cause)}")
        self.cause = cause


class NotABagError(InputError):
    """What was named is no bag of a swarm, or there is nothing of that name."""


class BagTooLargeError(InputError):
    """There is not enough memory for what was asked of a bag."""


class DamagedBagError(RunError):
    """A bag is cut off or changed; the text says where, and what can still be read."""
