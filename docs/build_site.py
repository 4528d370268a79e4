"""Build the documentation and the Python API as one site of HTML pages: python -m docs.build_site FOLDER.

Every warning is an error: an unresolved link or anchor, a formula that does not parse, a documented parameter that does
not exist.
"""

from __future__ import annotations

import ast
import json
import logging
import re
import shutil
import sys
import tempfile
import textwrap
from functools import partial
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import griffe
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from mkdocs.commands.build import build
from mkdocs.config import load_config
from mkdocs.exceptions import Abort
from pymdownx.slugs import slugify

if TYPE_CHECKING:
    from collections.abc import Iterator

    from markdown import Markdown

CHECKOUT = Path(__file__).resolve().parents[1]
PAGES = ("*.md", "docs/*.md", "docs/*/*.md", "examples/*/*.md", "src/*/*.md")
FILES = ("docs/images/*", "docs/reference/*.json")
NOTEBOOKS = "docs/*/*.ipynb"
SECTIONS = {
    "Tutorials": "tutorials",
    "How-to guides": "how-to",
    "Reference": "reference",
    "Explanation": "explanation",
    "Developers": "developers",
}
API = "docs/python"
_LINK = re.compile(r"(?<!!)\[((?:[^\[\]]|!\[[^\]]*\])*)\]\(([^)\s]+)\)")
_ROLE = re.compile(r":math:`([^`]+)`")
_DIRECTIVE = re.compile(r"^( *)\.\. math::(.*\n(?:(?:\1 +.*)?\n)*)", re.MULTILINE)
_MATHML = "{http://www.w3.org/1998/Math/MathML}"
_ACCENTS = set("\u02d9\u00a8\u20db\u02c6\u02dc^~")
ET.register_namespace("", _MATHML[1:-1])
_log = logging.getLogger("mkdocs.swarmabs")


def mathml(latex: str, *, block: bool = False) -> str:
    """Return a formula as MathML, which browsers show without a script."""
    try:
        return _indexed(tex2mathml(latex, as_block=block))
    except MathError as error:
        _log.warning("formula %r does not parse: %s", latex, error)
        return ""


def _indexed(text: str) -> str:
    """Move the indices of accented letters, which the converter puts below the letters, to their right."""
    plain = re.sub(r"&(?!lt;|gt;|amp;)\w+;", lambda entity: unescape(entity[0]), text)
    root = ET.fromstring(plain)  # noqa: S314 - made by docutils
    for both in root.iter(f"{_MATHML}munderover"):
        letter, index, accent = both
        if accent.text and set(accent.text) <= _ACCENTS:
            over = ET.Element(f"{_MATHML}mover", accent="true")
            over.extend([letter, accent])
            both.tag, both[:] = f"{_MATHML}msub", [over, index]
    return ET.tostring(root, encoding="unicode")


class InlineMath(InlineProcessor):
    """Replaces ``$...$``."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:  # noqa: ARG002 - given by markdown
        """Return a formula and its position."""
        return self.md.htmlStash.store(mathml(m[1])), m.start(), m.end()


class Math(Extension):
    """Inline formulas, found after code and before escapes."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Register the pattern."""
        md.inlinePatterns.register(InlineMath(r"\$(?=\S)([^$\n]+?)(?<=\S)\$(?!\d)", md), "math", 185)


def math_block(source: str, *_arguments: Any, **_options: Any) -> str:
    """Return a fenced block of mathematics as MathML."""
    return f"<div>{mathml(source, block=True)}</div>"


class MathOfDocstrings(griffe.Extension):
    """Converts the formulas of docstrings to those of pages."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Convert the docstring of a module, class, function or attribute."""
        if obj.docstring:
            text = _DIRECTIVE.sub(_fenced, f"{obj.docstring.value}\n")
            obj.docstring.value = _ROLE.sub(r"$\1$", text).rstrip()


def _fenced(found: re.Match[str]) -> str:
    lines = f"{found[1]}    {found[2].strip()}" if "\n\n" not in found[2].strip() else found[2]
    return textwrap.indent(f"\n```math\n{textwrap.dedent(lines).strip()}\n```\n\n", found[1])


def stage(folder: Path) -> None:
    """Copy the pages, and write pages for the notebooks and the Python API."""
    for pattern in (*PAGES, *FILES):
        for path in CHECKOUT.glob(pattern):
            copy = folder / path.relative_to(CHECKOUT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
    for path in CHECKOUT.glob(NOTEBOOKS):
        page = folder / path.relative_to(CHECKOUT).with_suffix(".md")
        page.write_text(notebook_page(path), encoding="utf-8")
    (folder / API).mkdir()
    for package in packages():
        (folder / API / f"{package}.md").write_text(api_page(package), encoding="utf-8")
    for page in folder.rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        page.write_text(_LINK.sub(partial(_staged_link, page), text), encoding="utf-8")


def _staged_link(page: Path, found: re.Match[str]) -> str:
    """Return a link unchanged if its target is part of the site, otherwise only its text."""
    text, target = found.groups()
    place, _, anchor = target.partition("#")
    if re.match(r"[a-z]+:", target) or not place:
        return found[0]
    if place.endswith(".ipynb"):
        return f"[{text}]({place.removesuffix('.ipynb')}.md{anchor and '#'}{anchor})"
    source = CHECKOUT / page.parent.relative_to(_root(page)) / place
    staged = (page.parent / place).is_file()
    return text if source.exists() and not staged else found[0]


def _root(page: Path) -> Path:
    return next(folder for folder in page.parents if (folder / "CONTRIBUTING.md").is_file())


def notebook_page(path: Path) -> str:
    """Return a notebook as a Markdown page."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return "\n\n".join(part for cell in cells for part in _cell(cell)) + "\n"


def _cell(cell: dict[str, Any]) -> Iterator[str]:
    source = "".join(cell["source"])
    yield source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```"
    for output in cell.get("outputs", ()):
        data = output.get("data", {"text/plain": output.get("text", "")})
        if "image/png" in data:
            yield f'<img alt="Figure" src="data:image/png;base64,{"".join(data["image/png"]).strip()}">'
        else:
            yield f"```text\n{''.join(data['text/plain'])}\n```"


def packages() -> list[str]:
    """Return the names of the Python packages."""
    return sorted(path.parent.name for path in CHECKOUT.glob("src/*/*/__init__.py"))


def api_page(package: str) -> str:
    """Return a page with the documentation of every public module of a package."""
    sources = CHECKOUT / "src" / package
    found = []
    for path in sorted((sources / package).rglob("*.py")):
        parts = path.relative_to(sources).with_suffix("").parts
        names = parts[:-1] if parts[-1] == "__init__" else parts
        if not any(name.startswith("_") for name in names) and ast.get_docstring(ast.parse(path.read_bytes())):
            found.append(f"::: {'.'.join(names)}\n")
    return f"# {package}\n\n" + "\n".join(found)


def navigation(folder: Path) -> list[dict[str, Any]]:
    """Return the navigation of the site."""

    def pages(pattern: str) -> list[str]:
        return sorted(str(path.relative_to(folder)) for path in folder.glob(pattern))

    sections = [{title: pages(f"docs/{name}/*.md")} for title, name in SECTIONS.items()]
    return [
        {"Start": ["README.md", "docs/README.md"]},
        *(section for section in sections if all(section.values())),
        {"Python API": pages(f"{API}/*.md")},
        {"Examples": pages("examples/*/*.md")},
        {"Packages": pages("src/*/*.md")},
        {"Project": ["CONTRIBUTING.md", "CHANGELOG.md", *sorted(_others(folder))]},
    ]


def _others(folder: Path) -> set[str]:
    return {path.name for path in folder.glob("*.md")} - {"README.md", "CONTRIBUTING.md", "CHANGELOG.md"}


def settings(folder: Path, output: Path) -> dict[str, Any]:
    """Return the configuration of MkDocs."""
    fences = [
        {"name": "math", "class": "math", "format": math_block},
        {"name": "mermaid", "class": "mermaid", "format": _mermaid},
    ]
    python = {
        "docstring_style": "numpy",
        "docstring_section_style": "list",
        "extensions": [f"{Path(__file__).resolve()}:MathOfDocstrings"],
        "filters": ["!^_"],
        "heading_level": 2,
        "show_if_no_docstring": False,
        "show_root_full_path": True,
        "show_root_heading": True,
        "show_source": False,
        "show_submodules": False,
        "separate_signature": True,
    }
    return {
        "site_name": "swarmabs",
        "docs_dir": str(folder),
        "site_dir": str(output),
        "strict": True,
        "use_directory_urls": False,
        "nav": navigation(folder),
        "theme": {
            "name": "material",
            "font": False,
            "features": ["navigation.indexes", "navigation.tabs", "navigation.top", "toc.follow"],
            "palette": [
                {"media": "(prefers-color-scheme: light)", "scheme": "default"},
                {"media": "(prefers-color-scheme: dark)", "scheme": "slate"},
            ],
        },
        "plugins": ["search", {"mkdocstrings": {"handlers": {"python": {"options": python}}}}],
        "markdown_extensions": [
            "tables",
            {"toc": {"slugify": slugify(case="lower"), "permalink": True}},
            "pymdownx.highlight",
            {"pymdownx.superfences": {"custom_fences": fences}},
            "docs.build_site:Math",
        ],
        "validation": {"links": {"anchors": "warn", "unrecognized_links": "warn", "not_found": "warn"}},
    }


def _mermaid(source: str, *_arguments: Any, **_options: Any) -> str:
    """Return a graph as text, which needs no external script."""
    return f"<pre><code>{source.replace('&', '&amp;').replace('<', '&lt;')}</code></pre>"


def main(arguments: list[str]) -> int:
    """Build the site in a folder, which is replaced."""
    if len(arguments) != 1:
        sys.stderr.write(f"{__doc__}\n")
        return 2
    output = Path(arguments[0]).resolve()
    with tempfile.TemporaryDirectory(prefix="swarmabs-docs-") as temporary:
        folder = Path(temporary) / "pages"
        folder.mkdir()
        stage(folder)
        configuration = Path(temporary) / "mkdocs.yml"
        configuration.write_text("site_name: swarmabs\n", encoding="utf-8")
        try:
            build(load_config(str(configuration), **settings(folder, output)))
        except Abort as error:
            sys.stderr.write(f"error: the documentation has faults: {error}\n")
            return 1
    sys.stdout.write(f"{output / 'index.html'}\n")
    return 0


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s: %(message)s")
    sys.exit(main(sys.argv[1:]))
