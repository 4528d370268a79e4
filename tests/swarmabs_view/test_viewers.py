"""Viewers beside a run: what they are told, how they end, and what is refused before."""

import os
import socket
from pathlib import Path
from typing import Any

import pytest

from swarmabs_cli import main
from swarmabs_core.errors import InputError
from swarmabs_view import ports, viewers
from swarmabs_view.ports import bound, check_foxglove
from swarmabs_view.viewers import MARKERS_LOG, PageViewer, ViewerProcess, markers_viewer


@pytest.mark.parametrize(
    ("words", "secret", "code"),
    [(["json.tool"], "[1]", 0), (["json.tool"], "[", 1), (["http.server", "0", "--bind", "127.0.0.1"], "", -9)],
)
def test_a_viewer_reads_its_secret_and_ends_with_its_standard_input_or_is_killed(
    words: list[str], secret: str, code: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewers, "END_SECONDS", 0.3 if code < 0 else 20.0)
    process = ViewerProcess(words[0], words[1:], secret=secret)
    assert process.close() == code
    process.wait()
    assert process.close() == code


class Viewer:
    """Takes the place of a viewer's process, which takes long to start; it ends with a code."""

    code = 0

    def __init__(self, *words: Any, secret: str = "", descriptors: Any = ()) -> None:
        self.words, self.secret = words, secret
        self.calls: list[str] = []
        for number in descriptors:
            with socket.socket(fileno=os.dup(number)) as inherited:
                self.address = inherited.getsockname()
        self.wait = lambda: self.calls.append("wait")

    def close(self) -> int:
        self.calls.append("close")
        return self.code


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[Viewer]:
    """Return the viewers that are started."""
    found: list[Viewer] = []

    def start(*words: Any, **options: Any) -> Viewer:
        found.append(Viewer(*words, **options))
        return found[-1]

    monkeypatch.setattr(viewers, "ViewerProcess", start)
    return found


@pytest.mark.parametrize("steered", [False, True])
def test_a_page_holds_its_port_and_hands_it_on(started: list[Viewer], tmp_path: Path, *, steered: bool) -> None:
    with PageViewer(0, steered=steered) as page:
        page.wait()
        port = int(page.url.rstrip("/").rpartition(":")[2])
        with pytest.raises(InputError, match=f"port {port} of 127.0.0.1: .*in use; choose another"):
            PageViewer(port)
        page.start(tmp_path)
        (viewer,) = started
        module, (folder, number) = viewer.words
        assert (module, folder, number.isdigit()) == ("swarmabs_view.sources", str(tmp_path), True)
        assert viewer.address == ("127.0.0.1", port)
        assert page.steering_url == (f"{page.url}#steer={viewer.secret}" if steered else None)
        assert len(viewer.secret) == (32 if steered else 0)
        page.wait()
        assert viewer.calls == ["wait"]
        page.start(tmp_path / "next")
        _, after = started
        assert (viewer.calls, after.calls) == (["wait", "close"], [])
        assert (after.address, after.secret) == (viewer.address, viewer.secret)
        assert after.words[1][0] == str(tmp_path / "next")
    assert after.calls == ["close"]
    bound(port).close()
    with PageViewer(0) as page:
        assert page.steering_url is None
    bound(int(page.url.rstrip("/").rpartition(":")[2])).close()


@pytest.mark.parametrize("code", [-9, 0, 1])
def test_markers_that_fail_are_told_of_when_the_run_is_over(
    code: int, started: list[Viewer], tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Viewer, "code", code)
    with pytest.raises(ZeroDivisionError), markers_viewer(tmp_path, ros=True, foxglove_port=None, clock=False):
        raise ZeroDivisionError
    with markers_viewer(tmp_path, ros=False, foxglove_port=8765, clock=True):
        assert started[1].calls == []
    module, words = started[0].words
    assert (module, words[:2]) == ("swarmabs_view.visualization.run_markers", [str(os.getpid()), str(tmp_path)])
    told = [words[2:] for _, words in (viewer.words for viewer in started)]
    assert told == [
        ["ros:=true", "clock:=false", "foxglove_port:=-1"],
        ["ros:=false", "clock:=true", "foxglove_port:=8765"],
    ]
    warning = f"warning: the process for RViz and Foxglove failed; see {tmp_path}/logs/{MARKERS_LOG}\n"
    assert capfd.readouterr().err == (warning if code > 0 else "")
    assert [viewer.calls for viewer in started] == [["close"]] * 2


def test_what_is_not_installed_or_taken_is_refused_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    with bound(0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} of .*in use; choose another --foxglove-port"):
            check_foxglove(port)
    check_foxglove(port)
    monkeypatch.setattr(ports, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"the view needs the Python package aiohttp; .*pip install aiohttp$"):
        PageViewer(0)
    with pytest.raises(InputError, match="the WebSocket for Foxglove needs the Python package foxglove-sdk"):
        check_foxglove(port)


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        (("a", "--namespace", "/b"), ("bag", Path("a"), "/b", 0)),
        (("--live", "/x", "--port", "7"), ("live", "/x", None, 7)),
    ],
)
@pytest.mark.parametrize("opens", [None, True, False])
def test_the_command_says_where_the_page_is_and_opens_it(
    words: tuple[str, ...],
    shown: tuple[Any, ...],
    opens: bool | None,  # noqa: FBT001 - a case
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    found: list[tuple[Any, ...]] = []

    def show(kind: str) -> Any:
        def view(target: Any, *, port: int, ready: Any, namespace: str | None = None) -> None:
            found.append((kind, target, namespace, port))
            ready("http://here/")

        return view

    for kind in ("bag", "live"):
        monkeypatch.setattr(f"swarmabs_cli.bags.view.view_{kind}", show(kind))
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or opens)
    assert main(["view", *words, *(["--open"] if opens is not None else [])]) == 0
    said = capfd.readouterr()
    assert (found, said.out) == ([shown], "http://here/\n")
    assert opened == ([] if opens is None else ["http://here/"])
    assert ("warning: no browser could be started" in said.err) == (opens is False)
