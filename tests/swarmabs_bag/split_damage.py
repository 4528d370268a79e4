"""Damage to a bag of several files, drawn from a seed: in any of them, in metadata.yaml, or to the folder."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from tests.swarmabs_bag.damage import BLIND, EXTREMES, HOSTILE_TEXTS, damage
from tests.swarmabs_bag.forgery import forge

from swarmabs_bag.metadata import load_yaml

METADATA = "metadata.yaml"
Files = dict[str, bytes]


class FolderDamage(NamedTuple):
    """What was done to a folder.

    Attributes
    ----------
    name : str
        The kinds of damage.
    in_files : bool
        Whether bytes of MCAP files were changed, and nothing else, in a way that a reader must notice.
    """

    name: str
    in_files: bool


def damage_folder(folder: Path, seed: int) -> FolderDamage:
    """Damage the bag in a folder."""
    generator = random.Random(seed)
    names, blind = [], True
    for _ in range(generator.choice((1, 1, 1, 2, 3))):
        if generator.random() < 0.4:
            name, noticeable = _damage_file(folder, generator)
        else:
            change = generator.choice(CHANGES)
            change(folder, generator)
            name, noticeable = change.__name__, False
        names.append(name)
        blind = blind and noticeable
    return FolderDamage("+".join(names), blind and len(names) == 1)


def _regular(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*.mcap") if path.is_file() and not path.is_symlink())


def _damage_file(folder: Path, generator: random.Random) -> tuple[str, bool]:
    files = [path for path in _regular(folder) if path.stat().st_size > 1000]
    if not files:
        return "nothing", False
    file, seed = generator.choice(files), generator.randrange(2**40)
    data = file.read_bytes()
    try:
        made = (damage if generator.random() < 0.7 else forge)(data, seed)
    except Exception:  # noqa: BLE001 - the second damage to a file may not find what it damages
        return "nothing", False
    file.write_bytes(made.data)
    return f"{file.name}: {made.name}", not made.sealed and made.data != data


def remove(folder: Path, generator: random.Random) -> None:
    for path in generator.sample(_regular(folder), min(generator.choice((1, 1, 2)), len(_regular(folder)))):
        path.unlink()


def shorten(folder: Path, generator: random.Random) -> None:
    for path in _some(folder, generator):
        os.truncate(path, generator.choice((0, 3, 8, 20, 60)))


def rename(folder: Path, generator: random.Random) -> None:
    for path in _some(folder, generator):
        number = generator.choice(("1", "7", "00", "999999999", "9999999999", "-1", "x", "\u0663"))
        path.rename(
            folder / generator.choice((f"bag_{number}.mcap", f"other_{number}.mcap", "bag.mcap", "bag_1.mcap.gz"))
        )


def exchange(folder: Path, generator: random.Random) -> None:
    files = _regular(folder)
    if len(files) > 1:
        one, other = generator.sample(files, 2)
        content = one.read_bytes()
        one.write_bytes(other.read_bytes())
        other.write_bytes(content)


def double(folder: Path, generator: random.Random) -> None:
    for path in _some(folder, generator):
        name = generator.choice(("bag_5.mcap", "bag_9.mcap", "bag_2.mcap", "x.mcap"))
        if not (folder / name).is_dir() and not (folder / name).is_fifo():
            (folder / name).write_bytes(path.read_bytes())


def put_in(folder: Path, generator: random.Random) -> None:
    """Put something else than a file in the place of one."""
    path = folder / generator.choice(("bag_1.mcap", "bag_5.mcap", METADATA, "bag", "x.mcap"))
    if path.is_dir() and not path.is_symlink():
        return
    path.unlink(missing_ok=True)
    kind = generator.randrange(5)
    if kind == 0:
        path.mkdir()
    elif kind == 1:
        path.symlink_to(path.name)
    elif kind == 2:
        path.symlink_to("bag_0.mcap")
    elif kind == 3:
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")


def change_yaml(folder: Path, generator: random.Random) -> None:
    """Damage metadata.yaml like any file, or write something else."""
    path = folder / METADATA
    if path.is_symlink() or not path.is_file():
        return
    data = bytearray(path.read_bytes())
    kind = generator.randrange(4)
    if kind == 0 and data:
        generator.choice(BLIND[:6])(data, generator)
    elif kind == 1:
        data[:] = generator.choice(HOSTILE_TEXTS)
    elif kind == 2:
        path.unlink()
        return
    else:
        data[:] = _edited(bytes(data), generator)
    path.write_bytes(data)


def _edited(data: bytes, generator: random.Random) -> bytes:
    document = load_yaml(data.decode("utf-8", "replace"))
    if not isinstance(document, dict):
        return data
    _change_value(document, generator)
    return yaml.safe_dump(document).encode()


def _change_value(document: Any, generator: random.Random) -> None:
    place: Any = document
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        if not keys:
            return
        key = generator.choice(keys)
        if not isinstance(place[key], (dict, list)) or generator.random() < 0.1:
            break
        place = place[key]
    place[key] = generator.choice((*EXTREMES, -1, 1.5, None, [], {}, "", "../../etc/passwd", "bag_0.mcap", [[]] * 3))


def _some(folder: Path, generator: random.Random) -> list[Path]:
    files = _regular(folder)
    return generator.sample(files, 1) if files else []


CHANGES: tuple[Callable[[Path, random.Random], None], ...] = (
    remove, shorten, rename, exchange, double, put_in, put_in, change_yaml, change_yaml, change_yaml,
)  # fmt: skip
