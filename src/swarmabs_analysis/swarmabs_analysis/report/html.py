"""Building blocks of a page. Text becomes nodes of a tree, so whatever it holds is escaped when the tree is written."""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

if TYPE_CHECKING:
    from collections.abc import Iterable

Child = ET.Element | str
_DOCTYPE = "<!DOCTYPE html>\n"


def element(tag: str, *children: Child, **attributes: str) -> ET.Element:
    """Return an element; an underscore in the name of an attribute stands for a hyphen, one at its end for nothing."""
    made = ET.Element(tag, {name.rstrip("_").replace("_", "-"): value for name, value in attributes.items()})
    last: ET.Element | None = None
    for child in children:
        if isinstance(child, ET.Element):
            made.append(child)
            last = child
        elif last is None:
            made.text = (made.text or "") + child
        else:
            last.tail = (last.tail or "") + child
    return made


def number(value: float | None, unit: str, digits: str = ".4g") -> ET.Element:
    """Return a number for people, with its exact value for programs."""
    if value is None:
        return element("span", "-")
    return element("data", f"{value:{digits}} {unit}".strip(), value=repr(value))


def table(heads: Iterable[str], rows: Iterable[Iterable[Child]], caption: str = "") -> ET.Element:
    """Return a table that scrolls by itself where the page is too narrow; the first cell of a row is its head."""
    made = element("table")
    if caption:
        made.append(element("caption", caption))
    heads = list(heads)
    if heads:
        made.append(element("thead", element("tr", *(element("th", head, scope="col") for head in heads))))
    body = element("tbody")
    for row in rows:
        first, *others = row
        body.append(element("tr", element("th", first, scope="row"), *(element("td", cell) for cell in others)))
    made.append(body)
    return element("div", made, class_="table")


def facts(pairs: Iterable[tuple[str, Child]]) -> ET.Element:
    """Return names and values as a list of descriptions."""
    made = element("dl")
    for name, value in pairs:
        made.append(element("div", element("dt", name), element("dd", value)))
    return made


def text_block(text: str) -> ET.Element:
    """Return text with its lines as they are."""
    return element("pre", "\n".join(_line(line) for line in text.splitlines()))


def document(page: ET.Element) -> str:
    """Return the text of a page."""
    return _DOCTYPE + ET.tostring(page, encoding="unicode", method="html") + "\n"


def _line(line: str) -> str:
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in line)
