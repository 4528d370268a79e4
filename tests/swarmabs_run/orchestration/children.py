"""Processes for a launcher to fork: each does what its arguments say."""

from __future__ import annotations

import signal
import sys
import time


def main(arguments: list[str]) -> int:
    action, *rest = arguments
    sys.stdout.write(f"{action} begins\n")
    if action == "exit":
        return int(rest[0])
    if action == "raise":
        raise RuntimeError(rest[0])
    if action == "ignore-sigterm":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.stdout.write("waiting\n")
    sys.stdout.flush()
    while True:
        time.sleep(60.0)
