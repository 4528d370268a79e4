"""Errors of writing and reading bags."""

from __future__ import annotations

import errno
from typing import TYPE_CHECKING

from swarmabs_config.installation import COMMAND
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from pathlib import Path

# Errors of the disk or the machine, not of the path given.
REMEDIES = {
    errno.ENOSPC: "free space on that disk, or record to another one with -o",
    errno.EDQUOT: "free some of your quota, or record to another disk with -o",
    errno.EFBIG: "raise the limit on file sizes (ulimit -f), or record for a shorter time",
    errno.EIO: "the disk reports a defect (see dmesg): record to another one with -o",
    errno.EMFILE: "raise the limit on open files (ulimit -n)",
    errno.ENFILE: "the machine has no free file descriptor: end other programs, or raise fs.file-max",
}

CONVERT = "convert it with ros2 bag convert (docs/how-to/ros.md)"
"""Remedy for a rosbag2 bag in an unsupported format."""


def remedy(cause: OSError) -> str:
    """Return the remedy for a file error."""
    return REMEDIES.get(cause.errno or 0, "check that disk, or record to another one with -o")


def repair_command(bag: Path | str) -> str:
    """Return the remedy for a damaged bag."""
    return f"repair it with {COMMAND} repair {bag}"


class BagFolderError(InputError):
    """The folder for a new bag cannot be used; nothing was written."""


class UnknownTypeError(InputError):
    """The definition of a message type is not installed or unknown."""


class BagWriteError(RunError):
    """Writing a bag failed; everything written before is kept."""

    def __init__(self, path: Path, cause: OSError) -> None:
        super().__init__(f"cannot write {path}: {cause.strerror or cause}; {remedy(cause)}")
        self.cause = cause


class NotABagError(InputError):
    """The path does not exist, or is not the bag of a swarm."""


class BagTooLargeError(InputError):
    """There is not enough memory to load a bag."""


class DamagedBagError(RunError):
    """A bag is truncated or corrupted; the text says where, and what can still be read."""
