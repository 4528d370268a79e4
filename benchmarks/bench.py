"""The entry point of ``swarm bench``: runs the programs of the selected suites in turn and combines their results."""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict
from datetime import datetime, timezone
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import psutil
from benchmarks.common import Settings
from benchmarks.results import read_result, write_result
from benchmarks.tables import Table, comparison, missing, notes, tables
from rich.console import Console
from rich.table import Table as RichTable

from swarmabs_bag.attached import versions
from swarmabs_bag.run_folder import new_run_folder, next_run_folder
from swarmabs_cli import exit_code
from swarmabs_cli.output import print_json
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.ending import die_with_parent, terminable

RUNS = Path("runs")
SCHEMA = 1
"""Version of the result format."""
PROGRAMS = {
    "product": "product",
    "start": "start",
    "memory": "start",
    "large": "large",
    "simulate": "simulate",
    "sweep": "sweep",
    "recorder": "recorder",
    "reading": "reading",
    "functions": "functions",
}
"""The program that measures each suite."""
WIDTH = 160
"""Width, characters, of tables printed to a file or pipe."""


def bench(settings: Settings, output: Path | None, *, as_json: bool) -> None:
    """Run the selected suites, and store and print the result.

    Raises
    ------
    InputError
        If the output folder is not empty, or a package is missing.
    RunError
        If a measured program fails; or, once the result is stored and printed, if it lacks measurements.
    """
    if "product" in settings.suites and find_spec("zmq") is None:
        raise InputError("pyzmq is missing, which the ZeroMQ baseline needs; start with ./scripts/swarm bench")
    folder = new_run_folder(output) if output is not None else next_run_folder(RUNS, "bench")
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "machine": machine_facts(),
        "settings": asdict(settings),
    }
    try:
        with terminable():
            for program in dict.fromkeys(PROGRAMS[suite] for suite in settings.suites):
                document |= _measured(program, settings)
        write_result(document, folder.path)
    finally:
        with suppress(OSError):  # not empty: it contains the result
            folder.path.rmdir()
    if as_json:
        print_json(document)
    else:
        _show(tables(document))
        for line in (*notes(document), f"folder: {folder.path}"):
            print(line)
    if lacking := missing(document):
        robots, name, why = lacking[0]
        raise RunError(f"{len(lacking)} measurements failed, such as {name} with {robots} robots: {why}")


def compare(paths: Sequence[str], *, as_json: bool) -> None:
    """Print a comparison of what two results both measured."""
    table = comparison(*(read_result(Path(path)) for path in paths))
    if as_json:
        print_json([dict(zip(table.headings, row, strict=True)) for row in table.rows])
    else:
        _show((table,))


def _measured(program: str, settings: Settings) -> dict[str, Any]:
    """Run a program and return its part of the result; it ends with this process, cleanly if interrupted."""
    with subprocess.Popen(
        [sys.executable, "-m", f"benchmarks.{program}", json.dumps(asdict(settings))],
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C in a terminal reaches only this process
        preexec_fn=partial(die_with_parent, os.getpid()),  # noqa: PLW1509 - makes only a system call
    ) as process:
        try:
            found, _ = process.communicate()
        except KeyboardInterrupt:
            process.send_signal(signal.SIGINT)
            process.wait()
            raise
    if process.returncode:
        raise RunError(f"the program benchmarks/{program}.py failed; see its messages above")
    document: dict[str, Any] = json.loads(found)
    return {suite: rows for suite, rows in document.items() if suite not in PROGRAMS or suite in settings.suites}


def machine_facts() -> dict[str, object]:
    """Return processor, kernel, memory, versions, limits and the load average of the last minute."""
    return {
        "processor": _processor(),
        "architecture": platform.machine(),
        "cores": os.cpu_count(),
        "usable_cores": len(os.sched_getaffinity(0)),
        "memory_bytes": psutil.virtual_memory().total,
        "kernel": platform.release(),
        "receive_buffer_max": _number("/proc/sys/net/core/rmem_max"),
        "load_before": round(os.getloadavg()[0], 2),
        "versions": {**versions(), **_version_of("pyzmq"), **_version_of("scipy")},
    }


def _processor() -> str | None:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        name, _, text = line.partition(":")
        if name.strip() == "model name":
            return text.strip()
    return None


def _number(path: str) -> int | None:
    try:
        return int(Path(path).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def _version_of(name: str) -> dict[str, str]:
    try:
        return {name: version(name)}
    except PackageNotFoundError:
        return {}


def _show(shown: Iterable[Table]) -> None:
    """Print tables to the terminal."""
    console = Console(highlight=False, width=None if sys.stdout.isatty() else WIDTH)
    for table in shown:
        made = RichTable(box=None, header_style="dim")
        for heading in table.headings:
            made.add_column(heading)
        for row in table.rows:
            made.add_row(*row)
        console.print(f"{table.name}: {table.caption}", soft_wrap=True)
        console.print(made)


def main() -> int:
    """Run the request that the command passes as JSON in its argument."""
    asked = json.loads(sys.argv[1])
    if asked["compare"]:
        return exit_code(lambda: compare(asked["compare"], as_json=asked["as_json"]))
    output = Path(asked["output"]) if asked["output"] is not None else None
    return exit_code(lambda: bench(Settings(**asked["settings"]), output, as_json=asked["as_json"]))


if __name__ == "__main__":
    sys.exit(main())
