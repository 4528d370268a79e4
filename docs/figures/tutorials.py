"""Draw the pictures of the tutorials by the scripts that their pages show: python docs/figures/tutorials.py FOLDER.

FOLDER is where tutorials were followed; pictures of tutorials that were not followed there are kept.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).parents[1]
PICTURES = {
    "first_controller": ("mine/plot.py", "mine/comparison.png"),
    "parent_system": ("ferry/plot.py", "ferry/roll.png"),
}
"""By page: the script as the page shows it, and the picture that it makes."""


def draw(folder: Path, target: Path) -> list[str]:
    """Draw what can be drawn into a folder, and return the pages whose picture is new."""
    drawn = []
    for page, (program, picture) in PICTURES.items():
        if not (folder / program).is_file():
            continue
        text = (DOCS / "tutorials" / f"{page}.md").read_text(encoding="utf-8")
        shown = re.search(rf"`{re.escape(program)}`:\n\n```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
        if shown is None:
            raise SystemExit(f"error: {page}.md does not show {program}")
        subprocess.run([sys.executable, "-c", shown[1]], cwd=folder, check=True)
        shutil.copy(folder / picture, target / f"{page}.png")
        drawn.append(page)
    return drawn


if __name__ == "__main__":
    if len(sys.argv) != 2 or not draw(Path(sys.argv[1]), DOCS / "images"):
        raise SystemExit("error: give the folder in which a tutorial was followed")
