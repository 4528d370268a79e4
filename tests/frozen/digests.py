"""Runs whose results must not change, and their digests.

In lockstep of scenarios with faults, noise, lag, steps and plug-in parts; in real time, on a simulated clock, of fleets
with bad networks, clocks, deaths and stops.
"""

import hashlib
from pathlib import Path
from typing import Any

from tests.frozen.command import ROOT, frozen, swarm, swarm_process
from tests.plugin_packages import install
from tests.virtual.fleet import Network, VirtualFleet

from swarmabs_config.scenario import load_scenario
from swarmabs_core.cdr import encode

CASES = frozen("digests")
"""By name: scenario, overrides, summary, and whether it is among the quick ones (quick) and run over DDS (run)."""

FLEETS = frozen("fleets")
"""By name: scenario, overrides, what happens to the fleet as [time in s, what, ...], and digest of all messages."""

MEASURED = {"wall_time", "setup_time", "startup_time", "run_time", "real_time_factor", "rerun_of"}
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
    packages, module = folder / f"packages_of_{name}", "swarmabs_sliding_mode"
    source = (ROOT / "examples" / "sliding_mode" / f"{module}.py").read_text(encoding="utf-8")
    install(packages, "controller", "sliding_mode", source, package=module, target=f"{module}:SLIDING_MODE")
    done = (swarm if command == "simulate" else swarm_process)(words, folder, (packages,))
    assert done.code == (case["summary"]["status"] != "ok"), f"{name}: {done.err}"
    return {key: value for key, value in done.document().items() if key not in MEASURED}


def difference(name: str, found: dict[str, Any]) -> dict[str, Any]:
    """Return of each field of a summary that is not as frozen: what it was, and what it is."""
    wanted = CASES[name]["summary"]
    return {key: (value, found.get(key)) for key, value in wanted.items() if found.get(key) != value}


def of_fleet(name: str) -> dict[str, Any]:
    """Let a fleet run; return the digest of when which node said what, and how many messages that were."""
    case = FLEETS[name]
    scenario = load_scenario(ROOT / "src/swarmabs_bringup/scenarios" / f"{case['scenario']}.yaml", case["set"])
    fleet = VirtualFleet(scenario, seed=scenario.seed, prompt=True)
    for time, what, *words in [*case["events"], [scenario.duration, "network", {}]]:
        fleet.run(time - fleet.time)
        if what == "network":
            fleet.network = Network(**words[0])
        else:
            getattr(fleet, what)(*words)
    found = hashlib.sha256()
    for at, node, message in fleet.published:
        found.update(f"{at} {node} {type(message).__name__} ".encode() + encode(message))
    return {"messages": len(fleet.published), "digest": found.hexdigest()}
