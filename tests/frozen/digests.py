"""Runs whose results must not change: scenarios with faults, noise, lag, steps, plug-in parts, and their digests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.frozen.command import ROOT, frozen, plugin_folder, swarm

CASES = frozen("digests")
"""By name: scenario, overrides, summary, and whether it is among the quick ones (quick) and run over DDS (run)."""

MEASURED = {"wall_time", "setup_time", "start_time", "real_time_factor", "rerun_of"}
"""Fields of a summary that are no result."""


def chosen(mark: str) -> list[str]:
    """Return the names of the cases that have a mark."""
    return [name for name, case in CASES.items() if case[mark]]


def summary(name: str, folder: Path, command: str = "simulate", *options: object) -> dict[str, Any]:
    """Run a case in a folder; return of its summary what is the same each time."""
    case = CASES[name]
    scenario = ROOT / "examples" / case["scenario"] if case["scenario"].endswith(".yaml") else case["scenario"]
    overrides = [word for each in case["set"] for word in ("--set", each)]
    words = (command, scenario, *overrides, *options, "--json", "-o", folder / name)
    done = swarm(words, folder, (plugin_folder(folder / "packages"),))
    assert done.code == 0, f"{name}: {done.err}"
    return {key: value for key, value in done.document().items() if key not in MEASURED}


def difference(name: str, found: dict[str, Any]) -> dict[str, Any]:
    """Return of each field of a summary that is not as frozen: what it was, and what it is."""
    wanted = CASES[name]["summary"]
    return {key: (value, found.get(key)) for key, value in wanted.items() if found.get(key) != value}
