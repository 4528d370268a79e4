"""Where a bag is: its file, or the files in which it goes on."""

from __future__ import annotations

import re
import stat
from itertools import islice
from typing import TYPE_CHECKING

from swarmabs_bag.errors import NotABagError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

SUFFIX = ".mcap"
_MOST_NAMED = 3


def find_bag(path: Path) -> Path:
    """Return the MCAP file of a run folder, of a bag's folder, or the file itself; of a split bag its folder.

    Raises
    ------
    NotABagError
        If there is none, or more than one that do not belong together.
    """
    try:
        mode = path.stat().st_mode
        if stat.S_ISREG(mode):
            return path
        if not stat.S_ISDIR(mode):
            raise _neither(path)
        for folder in (path / "bag", path):
            files = sorted(folder.glob(f"*{SUFFIX}"))
            if len(files) > 1:
                if split_files(files) is not None:
                    return folder
                raise NotABagError(f"{folder} holds {len(files)} .mcap files: name one of them")
            if files:
                mode = files[0].stat().st_mode
                if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                    raise _neither(files[0])
                return files[0]
    except (OSError, ValueError) as error:  # ValueError: the path has a NUL
        reason = error.strerror if isinstance(error, OSError) else error
        raise NotABagError(f"cannot read {path}: {reason}; name a run folder, its bag/, or an .mcap file") from error
    raise NotABagError(f"{path} holds no bag: name a run folder, its bag/, or an .mcap file")


def split_files(files: Iterable[Path]) -> dict[int, Path] | None:
    """Return the files of a split bag by number, None if they are not named ``NAME_0.mcap``, ``NAME_1.mcap``..."""
    found: dict[int, Path] = {}
    names = set()
    for file in files:
        match = re.fullmatch(r"(.*)_(0|[1-9]\d{0,8})", file.stem, re.ASCII)
        if match is None:
            return None
        names.add(match[1])
        found[int(match[2])] = file
    return dict(sorted(found.items())) if len(names) == 1 else None


def missing_files(files: dict[int, Path]) -> list[str]:
    """Return what is missing in the row of a split bag's files; not more than the first few, of what may be many."""
    name = next(iter(files.values())).stem.rpartition("_")[0]
    missing = (number for number in range(max(files)) if number not in files)
    return [f"{name}_{number}.mcap is missing" for number in islice(missing, _MOST_NAMED)]


def _neither(path: Path) -> NotABagError:
    return NotABagError(f"{path} is neither a folder nor a file: name a run folder, its bag/, or an .mcap file")
