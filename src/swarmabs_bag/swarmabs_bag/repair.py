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
    definitions_of,
    examine,
    metadata_problem,
    silent_topics,
    stops_early,
    topics_of,
)
from swarmabs_bag.metadata import (
    ABORTED_KEY,
    METADATA_FILE,
    REPAIRED_KEY,
    FileRecord,
    TopicRecord,
    bag_metadata,
    dump_yaml,
    write_metadata,
)
from swarmabs_bag.output import RecordFile
from swarmabs_bag.places import find_bag
from swarmabs_bag.rebuild import Rebuilt
from swarmabs_bag.repair_report import RepairReport, report_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from swarmabs_bag.index import FileIndex
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
    kept = _worth_keeping(found, parts)
    if in_place and any(part.name != part.path.name for part in kept):
        gap = next(iter(problems), None) or next(part.problems[0] for part in parts if part.found is None)
        raise BagFolderError(f"{found} cannot be repaired in place: {gap}; repair it into a new folder with -o")
    idle = not problems and not any(part.problems for part in parts)
    if folder is not None and idle and (problem := metadata_problem(folder, kept)) is not None:
        problems.append(problem)
    unfinished = _is_unfinished(found, parts, kept)
    if unfinished and ABORTED_KEY not in kept[-1].custom_data() and not kept[-1].problems:
        kept[-1].problems.append(CUT_OFF)
    idle = not problems and not any(part.problems for part in parts)
    if idle and (output is None or in_place):
        return report_of(named, None, found, parts, problems)
    if in_place:
        _refuse_earlier(parts, target)
    with _work_folder(target) as work:
        _write(kept, work, [] if folder is None else silent_topics(kept[0].path.parent), unfinished=unfinished)
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


def _worth_keeping(bag: Path, parts: Sequence[Part]) -> list[Part]:
    """Return the files in which there is anything.

    Raises
    ------
    DamagedBagError
        If there is no such file, or no message in any of them although something is lost.
    """
    kept = [part for part in parts if part.found is not None]
    if not kept:
        raise DamagedBagError(f"{bag}: nothing can be saved: {parts[0].problems[0]}")
    broken = [part for part in kept if part.found is not None and (part.found.damage or part.found.end is None)]
    if broken and not any(part.index.statistics.message_count for part in kept):
        raise DamagedBagError(f"{broken[0].path}: no message can be saved: {broken[0].problems[0]}")
    return kept


def _is_unfinished(bag: Path, parts: Sequence[Part], kept: Sequence[Part]) -> bool:
    """Tell whether the writer did not come to its end: its last file has none, or was never begun."""
    last = kept[-1]
    if last is not parts[-1] or (last.found is not None and last.found.end is None):
        return True
    return len(kept) > 1 and not (last.path.parent / METADATA_FILE).exists() and stops_early(bag)


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


def _write(parts: Sequence[Part], work: Path, silent: Sequence[TopicRecord], *, unfinished: bool) -> None:
    """Write the new files and ``metadata.yaml``, which goes on listing what was silent."""
    custom: dict[str, str] = {}
    for part in parts:
        if part.problems:
            said = part.custom_data()
            if unfinished and part is parts[-1]:
                said.setdefault(ABORTED_KEY, CUT_OFF)
            if part.found is not None and part.found.damage:
                said[REPAIRED_KEY] = _lost_text(part.found.damage)
            definitions = definitions_of([part.path for part in parts]) if len(parts) > 1 else None
            part.found = _rewritten(part, work / part.name, said, definitions)
        else:
            shutil.copyfile(part.path, work / part.name)
        custom |= part.custom_data()
    topics = topics_of(parts)
    found = {topic.name for topic, _ in topics}
    topics += [(topic, 0) for topic in silent if topic.name not in found]
    write_metadata(work, bag_metadata(topics, files=_file_records(parts), custom_data=custom))


def _rewritten(part: Part, path: Path, custom: Mapping[str, str], definitions: FileIndex | None) -> Rebuilt:
    def describe(found: Rebuilt) -> str:
        part.found = found
        return dump_yaml(bag_metadata(topics_of([part]), files=_file_records([part]), custom_data=custom))

    file = RecordFile(path)
    try:
        with part.path.open("rb") as stream:
            found = Rebuilt(stream, part.size, file, definitions=definitions, describe=describe)
        file.sync()
    finally:
        file.close()
    return found


def _file_records(parts: Sequence[Part]) -> list[FileRecord]:
    return [FileRecord.of(part.name, part.index.statistics) for part in parts]


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
