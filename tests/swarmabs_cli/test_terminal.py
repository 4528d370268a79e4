"""What a run shows on terminals of all kinds, and elsewhere."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest
from tests.frozen.command import swarm

SETTINGS = {"TERM": "xterm-256color", "LANG": "C.UTF-8", "PYTHONUTF8": "1"}
CLEARED = ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "COLORTERM")
COLOUR = re.compile(r"\x1b\[[0-9;]*\b3[0-7]m")


def shown(monkeypatch: pytest.MonkeyPatch, columns: int | None, **settings: str) -> str:
    """Return what a simulation writes to standard error, on a terminal of this width or into a pipe."""
    for name in CLEARED:
        monkeypatch.delenv(name, raising=False)
    for name, text in {**SETTINGS, "LINES": "30", **settings}.items():
        monkeypatch.setenv(name, text)
    done = swarm(("simulate", "--duration", "5", "--no-bag", "-o", "out"), Path.cwd(), columns=columns)
    assert done.code == 0 and "digest" in done.out
    return done.err


@pytest.mark.parametrize("settings", [{}, {"NO_COLOR": "1"}])
def test_a_terminal_gets_a_panel_that_is_taken_away(monkeypatch: pytest.MonkeyPatch, settings: dict[str, str]) -> None:
    text = shown(monkeypatch, 90, **settings)
    assert "╭─ pd_het_4: step " in text and "■" in text
    assert bool(COLOUR.search(text)) == (not settings)
    assert text.count("\x1b[?25l") == text.count("\x1b[?25h") == 1  # the cursor is there again
    assert text.rstrip().endswith("\x1b[2K")


def test_a_narrow_terminal_gets_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    text = shown(monkeypatch, 40)
    assert "pd_het_4: step " in text and "╭" not in text
    lines = [re.sub(r"\x1b\[[?0-9;]*[A-Za-z]", "", line) for line in re.split(r"[\r\n]+", text)]
    assert max(len(line) for line in lines if "step " in line) <= 40


@pytest.mark.parametrize(("columns", "kind"), [(90, "dumb"), (None, "xterm-256color")])
def test_a_dumb_terminal_and_a_pipe_get_lines(monkeypatch: pytest.MonkeyPatch, columns: int | None, kind: str) -> None:
    text = shown(monkeypatch, columns, TERM=kind)
    assert "pd_het_4: step " in text
    assert "\x1b" not in text and "╭" not in text


@pytest.mark.system
@pytest.mark.timeout(300)
def test_a_real_terminal_shows_a_run_of_many_processes(tmp_path: Path, nothing_survives: str) -> None:
    environment = {name: text for name, text in os.environ.items() if name not in CLEARED} | SETTINGS
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 90, 0, 0))
    words = [sys.executable, "-m", "swarmabs_cli", "run", "arise_het_4", "--duration", "30", "-o", "out"]
    with subprocess.Popen(words, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=theirs) as process:
        os.close(theirs)
        parts = []
        try:
            while data := os.read(ours, 65536):
                parts.append(data)
        except OSError:  # how Linux says that nobody has the other end open
            pass
        finally:
            os.close(ours)
        output = process.communicate(timeout=60)[0]
    assert process.returncode == 0 and b"digest" in output
    text = b"".join(parts).decode()
    assert re.search(r"starting, \d of 8 processes ready", text)
    assert "╭─ arise_het_4: step " in text and "4 active" in text and "■" in text
    assert "\x1b[2Kwarning: theorem ARISE_noHomo_sys" in text  # printed where the panel has been erased
