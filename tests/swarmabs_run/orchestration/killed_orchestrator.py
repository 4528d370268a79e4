"""An orchestrator that starts children and then waits to be killed: ``python killed_orchestrator.py LOGS``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from tests.swarmabs_run.orchestration.launching import child

from swarmabs_run.orchestration.launcher_client import LauncherClient

if __name__ == "__main__":
    logs = Path(sys.argv[1])
    client = LauncherClient({}, logs / "launcher.log", processes=2)
    for name in ("one", "two"):
        client.spawn(child(name), ["ignore-sigterm"], logs / f"{name}.log")
    while True:
        time.sleep(60.0)
