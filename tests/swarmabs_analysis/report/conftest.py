"""Short runs, their reports, and what a reader of the page finds in them."""

import warnings
from collections.abc import Sequence
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path

import pytest
from markupsafe import Markup
from matplotlib.figure import Figure
from tests.swarmabs_analysis.figures.conftest import record
from tests.swarmabs_bag.sample_run import SCENARIO, make_run, write_bag

from swarmabs_analysis.figures.style import styled
from swarmabs_analysis.report import Report, make_report
from swarmabs_analysis.report.panels import Panel
from swarmabs_analysis.report.pictures import page_picture
from swarmabs_core.messages import Message

CHANGES = (
    "plane.angle=0.015",
    "faults=[{at: 0.05, kind: kill, agent: 1}, {at: 0.1, kind: leave, agent: 2}, {at: 0.02, kind: join, agent: 4}]",
)
VOID = {"meta", "br", "link", "img", "input", "hr"}


class Page(HTMLParser):
    """The elements of a page; fails where they are not properly nested."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.rows: dict[str, list[str | float]] = {}
        self._open: list[str] = []
        self._row: list[str | float] | None = None
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)
        if tag == "tr":
            self._row = []
        if tag == "data" and self._row is not None:
            self._row.append(float(dict(attrs)["value"] or "nan"))

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag
        if tag == "tr" and self._row:
            self.rows[str(self._row[0])] = self._row
            self._row = None

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append((self._open[-1] if self._open else "", data))
            if self._row is not None and "data" not in self._open:
                self._row.append(data)


def write(
    folder: Path, messages: Sequence[Message], *, scenario: str = SCENARIO, provenance: bytes = b"{}", aborted: str = ""
) -> Path:
    """Write a bag of these messages."""
    attached = {"scenario.yaml": scenario.encode(), "provenance.json": provenance}
    return write_bag(folder, messages, attached, aborted=aborted)


def messages(steps: int) -> list[Message]:
    return make_run(steps)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have panels told on the page, and not drawn, which takes seconds."""

    monkeypatch.setattr(import_module("swarmabs_analysis.report.page"), "page_picture", told)


@pytest.fixture
def sketched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have panels drawn, but only those of angle and positions rendered, which takes seconds for all."""

    def sketch(panel: Panel) -> Markup:
        if panel.key in {"parent-0", "robots-coordinate-0"}:
            return page_picture(panel)
        with styled(), warnings.catch_warnings():
            warnings.filterwarnings("ignore", "All-NaN", RuntimeWarning)
            panel.draw(Figure())
        return told(panel)

    monkeypatch.setattr(import_module("swarmabs_analysis.report.page"), "page_picture", sketch)


def told(panel: Panel) -> Markup:
    """Return what a panel says to those who do not see it."""
    return Markup('<svg aria-label="{}. {}"></svg>').format(panel.heading, panel.about)


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a short run in which robots die, leave and join; not to be changed."""
    return record(tmp_path_factory.mktemp("report") / "run", "pd_het_4", *CHANGES)


@pytest.fixture(scope="session")
def report(run: Path) -> Report:
    return make_report(run)


@pytest.fixture(scope="session")
def page(report: Report) -> Page:
    return Page(report.html)
