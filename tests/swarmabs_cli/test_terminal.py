"""What a run shows on terminals of all kinds, and elsewhere."""

from __future__ import annotations

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

SWARM = [sys.executable, "-m", "swarmabs_cli"]
SIMULATE = [*SWARM, "simulate", "--duration", "100", "--no-bag", "-o", "out"]
SETTINGS = {"TERM": "xterm-256color", "LANG": "C.UTF-8", "PYTHONUTF8": "1"}
CLEARED = ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "COLORTERM")
COLOUR = re.compile(r"\x1b\[[0-9;]*\b3[0-7]m")


def shown(folder: Path, command: list[str] = SIMULATE, columns: int = 90, **settings: str) -> str:
    """Return what a command writes to a terminal of this width."""
    environment = {name: text for name, text in os.environ.items() if name not in CLEARED} | SETTINGS | settings
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=theirs) as process:
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
    return b"".join(parts).decode()


@pytest.mark.timeout(120)
def test_a_terminal_gets_a_panel_that_is_taken_away(tmp_path: Path) -> None:
    text = shown(tmp_path)
    assert "╭─ pd_het_4: step " in text and "steps/s" in text and "■" in text
    assert COLOUR.search(text)
    assert text.count("\x1b[?25l") == text.count("\x1b[?25h") == 1  # the cursor is there again
    assert text.rstrip().endswith("\x1b[2K")


@pytest.mark.system
@pytest.mark.timeout(120)
def test_so_does_a_run_of_many_processes(tmp_path: Path, nothing_survives: str) -> None:
    text = shown(tmp_path, [*SWARM, "run", "--duration", "30", "-o", "out"])
    assert re.search(r"starting, \d of 8 processes ready", text)
    assert "╭─ pd_het_4: step " in text and "4 active" in text and "■" in text


@pytest.mark.timeout(120)
def test_without_colours(tmp_path: Path) -> None:
    text = shown(tmp_path, NO_COLOR="1")
    assert "╭─ pd_het_4" in text
    assert not COLOUR.search(text)


@pytest.mark.timeout(120)
def test_a_narrow_terminal_gets_one_line(tmp_path: Path) -> None:
    text = shown(tmp_path, columns=40)
    assert "pd_het_4: step " in text and "╭" not in text
    lines = [re.sub(r"\x1b\[[?0-9;]*[A-Za-z]", "", line) for line in re.split(r"[\r\n]+", text)]
    assert max(len(line) for line in lines if "step " in line) <= 40


@pytest.mark.timeout(120)
def test_a_dumb_terminal_gets_lines(tmp_path: Path) -> None:
    text = shown(tmp_path, TERM="dumb")
    assert "pd_het_4: step " in text
    assert "\x1b" not in text and "╭" not in text


@pytest.mark.timeout(120)
def test_a_pipe_gets_lines(tmp_path: Path) -> None:
    environment = os.environ | SETTINGS
    ran = subprocess.run(
        SIMULATE, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60, check=True
    )
    assert "pd_het_4: step " in ran.stderr
    assert "\x1b" not in ran.stderr and "╭" not in ran.stderr
