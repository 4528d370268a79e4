"""The folder of a result: document, tables and charts."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from benchmarks.tables import draw, draw_large, markdown, notes, tables

from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

DOCUMENT, TABLES, CHART = "bench.json", "bench.md", "bench.svg"
LARGE_CHART = "large.svg"


def write_result(document: Mapping[str, Any], folder: Path) -> None:
    """Write a result, with the document last and atomically."""
    if "product" in document:
        draw(document, folder / CHART)
    if "large" in document:
        draw_large(document, folder / LARGE_CHART)
    parts = [
        *notes(document),
        *(f"## {table.name}\n\n{table.caption}\n\n{markdown(table)}" for table in tables(document)),
    ]
    (folder / TABLES).write_text("\n\n".join(parts), encoding="utf-8")
    part = folder / f"{DOCUMENT}.part"
    part.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    part.replace(folder / DOCUMENT)


def read_result(path: Path) -> dict[str, Any]:
    """Read a result from its document or its folder.

    Raises
    ------
    InputError
        If it is not a result.
    """
    file = path / DOCUMENT if path.is_dir() else path
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{file} cannot be read ({error.strerror}); give a folder that swarm bench has written"
        ) from None
    except ValueError:
        document = None
    if not isinstance(document, dict) or not {"schema", "machine", "settings"} <= document.keys():
        raise InputError(f"{file} is not a result of swarm bench; give a folder that it has written")
    return document
