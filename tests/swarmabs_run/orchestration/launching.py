"""What the tests of the launcher share."""

from __future__ import annotations

from pathlib import Path

from tests.processes import until

from swarmabs_run.orchestration.launcher_client import LauncherClient
from swarmabs_run.orchestration.plan import ProcessPlan


def child(name: str) -> ProcessPlan:
    """Return the plan of a process that does what its arguments say."""
    return ProcessPlan(name, "tests.swarmabs_run.orchestration.children", 8, {}, (), ())


class Reader:
    """Gathers the reports of a launcher and its children."""

    def __init__(self, client: LauncherClient) -> None:
        self._client = client
        self._reports: list[dict[str, object]] = []

    def wait_for(self, event: str, name: str) -> dict[str, object]:
        """Return the first report of an event of a child."""

        def found() -> list[dict[str, object]]:
            self._reports += self._client.read()
            return [report for report in self._reports if (report["event"], report.get("name")) == (event, name)]

        until(lambda: bool(found()), f"{event} {name}")
        return found()[0]


def is_waiting(log: Path) -> bool:
    """Tell whether a child has come to where it waits."""
    return log.is_file() and "waiting" in log.read_text(encoding="utf-8")
