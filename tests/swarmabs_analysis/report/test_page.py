"""The page needs nothing else, says nothing that a browser could take for commands, and is the same each time."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tests.swarmabs_analysis.report.conftest import SCENARIO, Page, messages, write

from swarmabs_analysis.report import Report, make_report
from swarmabs_analysis.report.record import read_recorded
from swarmabs_core.messages import EventKind, SwarmEvent

pytestmark = pytest.mark.timeout(60)
HOSTILE = "</td></pre><script>alert(1)</script><img src=x onerror='alert(2)'>\"&amp;\x00\x1b[31m\u202e $\\frac$"
NAME = "a<script>alert(3)<img src=x onerror=alert(4)>\"'&$\\frac$".replace("\\", "")
SCRIPT = """
import hashlib, sys
from pathlib import Path
from swarmabs_analysis.report import make_report
report = make_report(Path(sys.argv[1]))
print(hashlib.sha256(report.html.encode()).hexdigest(), hashlib.sha256(report.png).hexdigest())
"""


def assert_self_contained(html: str) -> None:
    page = Page(html)
    assert re.findall(r"https?:", html) == []
    assert "@import" not in html
    assert set(re.findall(r"url\((.)", html)) <= {"#"}
    assert re.search(r"\ssrc\s*=", re.sub(r">[^<]*<", "><", html)) is None
    assert {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "embed", "base", "form"} == set()
    identities = [str(attributes["id"]) for _, attributes in page.tags if "id" in attributes]
    assert len(identities) == len(set(identities))
    for tag, attributes in page.tags:
        assert not [name for name in attributes if name.startswith("on")]
        reference = attributes.get("href")
        if reference is not None:
            inside = reference.startswith("#") and reference[1:] in identities
            assert inside or (tag == "image" and reference.startswith("data:image/png;base64,"))
    policy = next(
        a["content"] for t, a in page.tags if t == "meta" and a.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy == "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def test_page_is_complete_and_refers_to_nothing(report: Report, page: Page) -> None:
    assert_self_contained(report.html)
    assert report.html.startswith("<!DOCTYPE html>\n<html lang=")
    headings = [text for tag, text in page.texts if tag == "h2"]
    contents = [text for tag, text in page.texts if tag == "a"]
    assert headings == contents
    assert {"Metrics", "Plane", "Robots", "Constraint margins", "Events", "Timing", "Scenario"} <= set(headings)
    assert [text for tag, text in page.texts if tag == "h1"] == ["pd_het_4"]
    assert "prefers-color-scheme: dark" in report.html
    pictures = [attributes for tag, attributes in page.tags if tag == "svg"]
    assert len(pictures) == 15 and all(one["role"] == "img" and one["aria-label"] for one in pictures)
    # No colour of a picture is fixed: all follow the scheme.
    assert re.findall(r'style="[^"]*#[0-9a-f]{6}', report.html) == []
    assert report.png.startswith(b"\x89PNG")


def test_hostile_text_stays_text(tmp_path: Path) -> None:
    run = [*messages(40), SwarmEvent(0, 0, 2, EventKind.DEAD, 0.0, HOSTILE)]
    run += [SwarmEvent(0, 0, 1, 200, float("nan"), HOSTILE)]
    provenance = {"driver": HOSTILE, "machine": [HOSTILE], "versions": {HOSTILE: {HOSTILE: 1}}}
    scenario = SCENARIO.replace("name: sample", f"name: {json.dumps(NAME)}")
    folder = write(
        tmp_path / "bag", run, scenario=scenario, provenance=json.dumps(provenance).encode(), aborted=HOSTILE
    )
    report = make_report(folder)
    assert_self_contained(report.html)
    page = Page(report.html)
    assert [text for tag, text in page.texts if tag == "h1"] == [NAME]
    shown = HOSTILE.replace("\x00", "\ufffd").replace("\x1b", "\ufffd").replace("\u202e", "\ufffd")
    assert page.texts.count(("td", shown)) == 2
    assert ("th", shown) in page.texts
    assert any(shown in text for tag, text in page.texts if tag == "p")  # why it ended
    assert "\x00" not in report.html and "\x1b" not in report.html and "\u202e" not in report.html


def test_timing_of_another_run_is_not_taken(tmp_path: Path) -> None:
    write(tmp_path / "bag", messages(40))
    for summary in ({"digest": "0" * 64, "wall_time": 3.5}, [], {"wall_time": "<script>"}):
        (tmp_path / "summary.json").write_text(json.dumps(summary))
        recorded = read_recorded(tmp_path)
        assert recorded.summary is None
        assert "it is of another run" in recorded.summary_note
    digest = recorded.metrics["digest"]
    summary = {"digest": digest, "wall_time": 3.5, "real_time_factor": 0.2}
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    page = Page(make_report(tmp_path).html)
    assert page.rows["Wall time"][1] == 3.5
    assert page.rows["Stepping"][1] == pytest.approx(2.0)
    assert page.rows["Speed"][1] == pytest.approx(20.0)
    assert page.rows["Rest"][1] == pytest.approx(1.5)
    (tmp_path / "summary.json").write_text(json.dumps(summary | {"setup_time": 0.5, "startup_time": 0.7}))
    page = Page(make_report(tmp_path).html)
    assert [page.rows[name][1] for name in ("Set-up", "Start", "Rest")] == pytest.approx([0.5, 0.7, 0.3])


def test_other_processes_and_places_give_the_same_bytes(report: Report, run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path / "elsewhere")
    found = [
        subprocess.run(
            [sys.executable, "-c", SCRIPT, path], capture_output=True, text=True, check=True, timeout=50
        ).stdout
        for path in (run, tmp_path / "elsewhere")
    ]
    assert found[0] == found[1]
    again = make_report(run)
    assert (again.html, again.png) == (report.html, report.png)
