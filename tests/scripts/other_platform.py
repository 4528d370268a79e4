"""``python other_platform.py COMMAND...``: command lines on a Python without what only Linux or only POSIX has.

The first that fails ends it, with its exit code. It stands in for Windows and macOS, as far as names go: these modules
and functions are absent there.
"""

import os
import shlex
import signal
import sys
import time
from types import ModuleType

import psutil  # needs on Linux what is absent below

POSIX_MODULES = ("fcntl", "grp", "pwd", "resource", "termios")
ABSENT: dict[ModuleType, tuple[str, ...]] = {
    os: ("O_DIRECTORY", "O_NONBLOCK", "O_PATH", "posix_fallocate", "sched_getaffinity", "sysconf"),
    signal: ("SIGHUP", "pthread_sigmask"),
    time: ("CLOCK_BOOTTIME", "clock_gettime"),
}


def main() -> int:
    assert psutil.Process().pid == os.getpid()
    for name in POSIX_MODULES:
        sys.modules[name] = None  # type: ignore[assignment]
    for module, names in ABSENT.items():
        for name in names:
            delattr(module, name)
    from swarmabs_cli import main as command  # noqa: PLC0415 - after the names are gone
    from swarmabs_run.orchestration import run_files  # noqa: PLC0415

    run_files.start_of = lambda _: None  # /proc
    for line in sys.argv[1:]:
        if code := command(shlex.split(line)):
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
