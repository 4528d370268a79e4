"""The pages of the documentation, and what tests look for in them."""

import re
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PATTERNS = ("*.md", "docs/*.md", "docs/*/*.md", "examples/*/*.md", "src/*/*.md")
PAGES = tuple(page for pattern in PATTERNS for page in sorted(ROOT.glob(pattern)))
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]


def read(name: str) -> str:
    """Return the text of a page."""
    return (ROOT / name).read_text(encoding="utf-8")


def script(path: str) -> Any:
    """Return a script that is in no package, imported by its path."""
    spec = spec_from_file_location(Path(path).name.replace(".", "_"), ROOT / path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def section(text: str, heading: str) -> str:
    """Return what stands below a heading, up to the next one of any level."""
    found = re.search(rf"^#+ {re.escape(heading)}\n(.*?)(?=^#|\Z)", text, re.MULTILINE | re.DOTALL)
    assert found, f"no section {heading!r}"
    return found[1]


def blocks(text: str, language: str) -> list[str]:
    """Return the blocks of code of a language."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [code for name, code in found if name == language]


def rows(text: str) -> list[list[str]]:
    """Return the cells of all tables, without headings."""
    tables = re.findall(r"^\|.*\n\| ?---.*\n((?:\|.*\n?)*)", text, re.MULTILINE)
    lines = [line for table in tables for line in table.splitlines()]
    return [[cell.strip().replace(r"\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def spans(text: str) -> list[str]:
    """Return what is set as code within lines."""
    without_blocks = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"`([^`\n]+)`", without_blocks)
