"""Update tables and charts of the performance pages from a result: python -m benchmarks.page RESULT."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from benchmarks.results import read_result
from benchmarks.tables import draw, draw_large, markdown, notes, tables

DOCS = Path(__file__).parents[1] / "docs"
PAGES = (*DOCS.glob("*/performance.md"), *(DOCS / "explanation" / name for name in ("arithmetic.md", "scaling.md")))
CHART, LARGE_CHART = DOCS / "images" / "speed.svg", DOCS / "images" / "large.svg"
_PART = re.compile(r"(<!-- bench: ([a-z]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def main(arguments: list[str]) -> int:
    """Update the parts that the result contains; all others remain unchanged."""
    if len(arguments) != 1:
        sys.stderr.write(f"{__doc__}\n")
        return 2
    document = read_result(Path(arguments[0]))
    parts = {}
    for table in tables(document):
        parts[table.name] = f"{table.caption[0].upper()}{table.caption[1:]}.\n\n{markdown(table)}"
    parts["notes"] = "".join(f"- {note}\n" for note in notes(document))

    def updated(found: re.Match[str]) -> str:
        return f"{found[1]}{parts[found[2]]}{found[3]}" if found[2] in parts else found[0]

    for page in PAGES:
        page.write_text(_PART.sub(updated, page.read_text(encoding="utf-8")), encoding="utf-8")
    if "product" in document:
        draw(document, CHART)
    if "large" in document:
        draw_large(document, LARGE_CHART)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
