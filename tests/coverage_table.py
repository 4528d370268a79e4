"""Lines and branches that the tests run, by package: ``python -m tests.coverage_table FOLDER``; pages go there too."""

import json
import sys
from collections import Counter
from pathlib import Path

from coverage import Coverage

COUNTED = ("covered_lines", "num_statements", "covered_branches", "num_branches")


def package(file: str) -> str:
    folder = Path(file).resolve().parent
    while (folder.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder.name


def row(name: str, counts: Counter[str]) -> str:
    lines, branches = (100.0 * counts[part] / max(1, counts[all_]) for part, all_ in (COUNTED[:2], COUNTED[2:]))
    return f"| `{name}` | {counts['num_statements']} | {lines:.1f} % | {counts['num_branches']} | {branches:.1f} % |"


def main(folder: Path) -> None:
    measured = Coverage(data_file=folder / "data")
    measured.load()
    measured.html_report(directory=str(folder))
    document = folder / "coverage.json"
    measured.json_report(outfile=str(document))
    packages: dict[str, Counter[str]] = {}
    for file, found in json.loads(document.read_text(encoding="utf-8"))["files"].items():
        counts = packages.setdefault(package(file), Counter())
        counts.update({name: found["summary"][name] for name in COUNTED})
    rows = [row(name, counts) for name, counts in sorted(packages.items())]
    head = ["| package | lines | run | branches | taken |", "| --- | --- | --- | --- | --- |"]
    sys.stdout.write("\n".join((*head, *rows, row("all", sum(packages.values(), Counter())), "")))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
