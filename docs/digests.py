"""Write the digests of built-in and example scenarios into docs/reference/digests.md: python docs/digests.py.

The table is between the lines ``<!-- digests -->`` and ``<!-- end -->``. A test fails if a digest is another.
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

import tomllib

from swarmabs_bag.run.digest import Digest
from swarmabs_config.scenarios import builtin_scenarios, find_scenario
from swarmabs_run.simulated_run import simulated_steps

DOCS = Path(__file__).parent
PAGE = DOCS / "reference" / "digests.md"
EXAMPLES = DOCS.parent / "examples"
_TABLE = re.compile(r"(<!-- digests -->\n).*?(<!-- end -->)", re.DOTALL)


def packages() -> list[Path]:
    """Return the folders of the examples that are packages with scenarios."""
    return sorted(path.parent for path in EXAMPLES.glob("*/pyproject.toml") if any(path.parent.glob("*.yaml")))


def install(folder: Path) -> None:
    """Make the packages of the examples importable, and their parts known by metadata in a folder."""
    for package in packages():
        project = tomllib.loads((package / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        metadata = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
        metadata.mkdir()
        text = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
        (metadata / "METADATA").write_text(text, encoding="utf-8")
        parts = (
            f"[{group}]\n" + "".join(f"{name} = {target}\n" for name, target in entries.items())
            for group, entries in project["entry-points"].items()
        )
        (metadata / "entry_points.txt").write_text("".join(parts), encoding="utf-8")
        sys.path.append(str(package))
    sys.path.append(str(folder))


def scenarios() -> list[str]:
    """Return the names of built-in scenarios, then the paths of those of the examples."""
    paths = [*EXAMPLES.glob("*.yaml"), *(path for package in packages() for path in package.glob("*.yaml"))]
    return [*builtin_scenarios(), *(path.relative_to(DOCS.parent).as_posix() for path in sorted(paths))]


def digest(name: str) -> str:
    """Return the digest of a simulation of a scenario."""
    path = DOCS.parent / name
    found = Digest()
    for step in simulated_steps(find_scenario(str(path) if path.is_file() else name).resolved()):
        found.update(step)
    return found.hexdigest()


def table(digests: dict[str, str]) -> str:
    """Return the table of digests by scenario."""
    rows = "".join(f"| `{name}` | `{found}` |\n" for name, found in digests.items())
    return f"| scenario | digest |\n| --- | --- |\n{rows}"


def stated() -> dict[str, str]:
    """Return the digests that the page states, by scenario."""
    return dict(re.findall(r"^\| `(\S+)` \| `([0-9a-f]{64})` \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE))


def main() -> int:
    """Update the table."""
    with tempfile.TemporaryDirectory() as folder:
        install(Path(folder))
        found = table({name: digest(name) for name in scenarios()})
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(_TABLE.sub(lambda match: f"{match[1]}{found}{match[2]}", text), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
