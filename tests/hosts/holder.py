"""The process whose network namespace holds the kernel's bridges between test hosts.

Usage: python -m tests.hosts.holder PARENT
"""

from __future__ import annotations

import signal
import sys

from tests.hosts.namespaces import hold_cables, say

if __name__ == "__main__":
    hold_cables(int(sys.argv[1]))
    say("ready")
    signal.pause()
