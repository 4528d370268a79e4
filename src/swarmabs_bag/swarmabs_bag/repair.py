"""Making a whole bag of a damaged one, and saying what was lost."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from swarmabs_bag.errors import BagFolderError, BagWriteError, DamagedBagError
from swarmabs_bag.examination import (
    Part,
    custom_data,
    definitions_of,
    examine,
    metadata_problem,
    stops_early,
    topics_of,
    topics_of_file,
)
from swarmabs_bag.metadata import (
    ABORTED_KEY,
    METADATA_FILE,
    RECORD_KEY,
    REPAIRED_KEY,
    FileRecord,
    bag_metadata,
    dump_yaml,
    write_metadata,
)
from swarmabs_bag.output import RecordFile
from swarmabs_bag.reader import find_bag
from swarmabs_bag.rebuild import rebuild
from swarmabs_bag.repair_report import RepairReport, report_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from swarmabs_bag.index import FileIndex
    from swarmabs_bag.rebuild import Output, Rebuilt
    from swarmabs_bag.salvage import Damage

CUT_OFF = "the recording was cut off"
"""Reason under `ABORTED_KEY` of a bag whose writer did not come to its end."""

_KEPT_SUFFIX = ".damaged"
_TEMPORARY = ".repairing"


def repair_bag(path: Path | str, output: Path | None = None, *, in_place: bool = False) -> RepairReport:
    """Make a whole bag of a damaged one.

    Every chunk, attachment and other record that is whole is kept as it is, of a chunk that the file's end cuts off
    the whole messages; all indexes, the summary section and ``metadata.yaml`` are made anew. A file that is whole
    stays as it is, byte by byte.

    Parameters
    ----------
    path : Path or str
        A run folder, its ``bag/``, or an MCAP file.
    output : Path, optional
        Folder of the new bag, which must not exist or be empty; by default it is beside the damaged one, with
        ``_repaired`` behind its name, and not made if there is nothing to do.
    in_place : bool
        Whether the new files take the names of the damaged ones, which are kept with ``.damaged`` behind theirs.

    Raises
    ------
    NotABagError
        If there is nothing, or something that is no bag.
    BagFolderError
        If the output exists, or a bag cannot be repaired in place.
    DamagedBagError
        If no message can be saved.
    BagWriteError
        If the disk is full or fails; nothing is left behind.
    """
    named = Path(path)
    found = find_bag(named)
    folder = None if named.is_file() else found if found.is_dir() else found.parent
    target = _target(found if folder is None else folder, output, in_place=in_place, is_file=folder is None)
    parts, problems = examine(found)
    kept = [part for part in parts if part.found is not None]
    if not kept:
        raise DamagedBagError(f"{found}: nothing can be saved: {parts[0].problems[0]}")
    broken = [part for part in kept if part.found is not None and (part.found.damage or not part.found.ended)]
    if broken and not any(part.found.index.statistics.message_count for part in kept if part.found is not None):
        raise DamagedBagError(f"{broken[0].path}: no message can be saved: {broken[0].problems[0]}")
    if in_place and any(part.name != part.path.name for part in kept):
        gap = next(iter(problems), None) or next(part.problems[0] for part in parts if part.found is None)
        raise BagFolderError(f"{found} cannot be repaired in place: {gap}; repair it into a new folder with -o")
    unfinished = kept[-1] is not parts[-1] or (kept[-1].found is not None and not kept[-1].found.ended)
    if folder is not None:
        problem = metadata_problem(folder, kept)
        if problem is not None and not problems and not any(part.problems for part in parts):
            problems.append(problem)
    if len(kept) > 1 and not unfinished and not (kept[0].path.parent / METADATA_FILE).exists():
        unfinished = stops_early(found)
    if unfinished and custom_data(kept[-1].found).get(ABORTED_KEY) is None and not kept[-1].problems:
        kept[-1].problems.append(CUT_OFF)
    idle = not problems and not any(part.problems for part in parts)
    if idle and (output is None or in_place):
        return report_of(named, None, found, parts, problems)
    if in_place:
        _refuse_earlier(parts, target)
    with _work_folder(target) as work:
        _write(kept, work, unfinished=unfinished)
        report = report_of(named, target, work, parts, problems)
        if in_place:
            _exchange(parts, work, found.parent if folder is None else folder, with_metadata=folder is not None)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            work.rename(target)
    return report


def _target(bag: Path, output: Path | None, *, in_place: bool, is_file: bool) -> Path:
    """Return where the new bag goes, and refuse what is in its way."""
    place = bag.resolve()
    if in_place:
        if output is not None:
            raise BagFolderError("a bag is repaired either in place or into a new folder: leave out --in-place or -o")
        return place.parent if is_file else place
    target = output if output is not None else place.with_name(f"{place.stem if is_file else place.name}_repaired")
    try:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise BagFolderError(f"{target} exists: name a new folder with -o")
    except OSError as error:
        raise BagFolderError(f"{target} cannot be used: {error.strerror}; name another folder with -o") from error
    return target


def _refuse_earlier(parts: Sequence[Part], folder: Path) -> None:
    """Refuse to replace what an earlier repair has kept."""
    names = [part.path.name for part in parts if part.problems] + [METADATA_FILE]
    for kept in (folder / (name + _KEPT_SUFFIX) for name in names):
        if kept.exists() or kept.is_symlink():
            raise BagFolderError(f"{kept} is there from an earlier repair: move it away, or name a folder with -o")
    if (folder / METADATA_FILE).is_dir():
        raise BagFolderError(f"{folder / METADATA_FILE} is a folder: move it away, or name a folder with -o")


def _lost_text(damage: Sequence[Damage]) -> str:
    first = damage[0]
    places = "1 place" if len(damage) == 1 else f"{len(damage)} places"
    lost = sum(part.size for part in damage)
    return f"{lost} bytes in {places} could not be saved, the first at byte {first.offset}: {first.problem}"


def _file_record(name: str, index: FileIndex) -> FileRecord:
    statistics = index.statistics
    return FileRecord(name, statistics.message_start_time, statistics.message_end_time, statistics.message_count)


@contextmanager
def _work_folder(target: Path) -> Iterator[Path]:
    """Make a folder beside the target, which is gone afterwards unless it was renamed."""
    place = target.resolve()
    work = place.with_name(f".{place.name}{_TEMPORARY}")
    made: list[Path] = []
    done = False
    try:
        for parent in reversed([parent for parent in work.parents if not parent.exists()]):
            parent.mkdir()
            made.append(parent)
        if work.exists():
            shutil.rmtree(work)
        work.mkdir()
        yield work
        done = True
    except OSError as error:
        raise BagWriteError(target, error) from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if not done:
            for parent in reversed(made):
                parent.rmdir()


def _write(parts: Sequence[Part], work: Path, *, unfinished: bool) -> None:
    """Write the new files and ``metadata.yaml``."""
    for part in parts:
        if not part.problems:
            shutil.copyfile(part.path, work / part.name)
            continue
        custom = custom_data(part.found)
        if unfinished and part is parts[-1]:
            custom.setdefault(ABORTED_KEY, CUT_OFF)
        if part.found is not None and part.found.damage:
            custom[REPAIRED_KEY] = _lost_text(part.found.damage)
        part.found = _rewritten(part, work / part.name, custom, _shared(parts))
    custom = {}
    for part in parts:
        custom |= custom_data(part.found)
    description = bag_metadata(
        topics_of(parts),
        files=[_file_record(part.name, part.found.index) for part in parts if part.found is not None],
        custom_data=custom,
    )
    write_metadata(work, description)


def _shared(parts: Sequence[Part]) -> FileIndex | None:
    return definitions_of([part.path for part in parts]) if len(parts) > 1 else None


def _rewritten(part: Part, path: Path, custom: Mapping[str, str], definitions: FileIndex | None) -> Rebuilt:
    def describe(found: Rebuilt) -> str:
        description = bag_metadata(
            topics_of_file(found.index), files=[_file_record(part.name, found.index)], custom_data=custom
        )
        found.description = {RECORD_KEY: dump_yaml(description)}
        return found.description[RECORD_KEY]

    file: RecordFile = RecordFile(path)
    output: Output = file
    try:
        with part.path.open("rb") as stream:
            found = rebuild(stream, part.size, output, definitions=definitions, describe=describe)
        file.sync()
    finally:
        file.close()
    return found


def _exchange(parts: Sequence[Part], work: Path, folder: Path, *, with_metadata: bool) -> None:
    """Put the new files in the places of the old ones, which keep their content under another name."""
    for part in parts:
        kept = part.path.with_name(part.path.name + _KEPT_SUFFIX)
        if part.found is None:
            part.path.rename(kept)
        elif part.problems:
            os.link(part.path, kept)
            (work / part.name).replace(part.path)
    if with_metadata:
        old = folder / METADATA_FILE
        if old.exists() or old.is_symlink():  # a link that leads nowhere is kept too
            os.link(old, old.with_name(METADATA_FILE + _KEPT_SUFFIX))
        (work / METADATA_FILE).replace(old)
