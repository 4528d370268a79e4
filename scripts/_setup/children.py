"""Run installers and compilers: log their output, stop them when interrupted, explain failures."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
from typing import Callable, Mapping, Optional, Sequence

from _setup.report import SetupError

LAST_LINES = 12
LINE_WIDTH = 200  # pip writes lines of thousands of characters
# (pattern in a log, message for the user)
CAUSES = (
    (r"No space left on device|Disk quota exceeded", "the disk is full"),
    (
        r"name resolution|Connection refused|NewConnectionError|timed out|ProxyError",
        "the package index is unreachable",
    ),
    (r"DO NOT MATCH THE HASHES", "a downloaded package does not match its hash in the lock file"),
)


def run_logged(
    command: Sequence[str],
    log: str,
    environ: Mapping[str, str],
    lock: int,
    watch: Optional[Callable[[str], None]] = None,
) -> None:
    """Run a command with its output in a log file; an exception meanwhile stops its whole process group.

    Raises
    ------
    SetupError
        If the command fails; the message has the last lines of the log and its path.
    """
    os.makedirs(os.path.dirname(log), exist_ok=True)
    with open(log, "w", encoding="utf-8") as output:
        child = subprocess.Popen(
            command,
            cwd=os.path.dirname(log),  # has no modules that could shadow those that the command imports
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            env=dict(environ),
            start_new_session=True,
            pass_fds=[lock],
        )
    try:
        while child.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(timeout=0.3)
            if watch:
                watch(read_log(log))
    finally:
        if child.returncode is None:
            end_group(child)
    if child.returncode != 0:
        raise SetupError(failure_text(child.returncode, log))


def end_group(child: subprocess.Popen[bytes]) -> None:
    """Stop a command and all processes in its group."""
    os.killpg(child.pid, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(timeout=5)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)
    child.wait()


def read_log(path: str) -> str:
    """Text of a log; invalid bytes are replaced."""
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.read()


def failure_text(status: int, log: str) -> str:
    """Describe a failure: the cause, if the log shows it, and the end of the log."""
    text = read_log(log)
    step = os.path.splitext(os.path.basename(log))[0]
    known = (meaning for sign, meaning in CAUSES if re.search(sign, text))
    cause = next(known, f"{step} failed with exit code {status}")
    last = [line.rstrip()[:LINE_WIDTH] for line in text.splitlines() if line.strip()][-LAST_LINES:]
    return "\n".join([f"{cause}; start again to continue. Last lines of {log}:", *(f"    {line}" for line in last)])
