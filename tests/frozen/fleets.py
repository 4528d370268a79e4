"""Fleets in real time on a simulated clock, whose messages must not change: bad networks, clocks, deaths, stops."""

from __future__ import annotations

import hashlib
from typing import Any

from tests.frozen.command import ROOT, frozen
from tests.virtual_fleet import Network, VirtualFleet

from swarmabs_config.scenario import load_scenario
from swarmabs_core.cdr import encode

CASES = frozen("fleets")
"""By name: scenario, overrides, what happens to the fleet as [time in s, what, ...], and digest of all messages."""


def digest(name: str) -> dict[str, Any]:
    """Let a fleet run; return the digest of when which node said what, and how many messages that were."""
    case = CASES[name]
    scenario = load_scenario(ROOT / "src/swarmabs_bringup/scenarios" / f"{case['scenario']}.yaml", case["set"])
    fleet = VirtualFleet(scenario, seed=scenario.seed)
    for time, what, *words in [*case["events"], [scenario.duration, "network", {}]]:
        fleet.run(time - fleet.time)
        if what == "network":
            fleet.network = Network(**words[0])
        elif what == "call":
            node, method = words
            fleet.call(node, lambda behaviour, now, method=method: getattr(behaviour, method)(now))  # type: ignore[misc]
        else:
            getattr(fleet, what)(*words)
    found = hashlib.sha256()
    for at, node, message in fleet.published:
        found.update(f"{at} {node} {type(message).__name__} ".encode() + encode(message))
    return {"messages": len(fleet.published), "digest": found.hexdigest()}
