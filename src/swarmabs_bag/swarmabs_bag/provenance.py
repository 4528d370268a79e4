"""What a bag says of where it comes from."""

from __future__ import annotations

import json
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.fingerprint import libm_fingerprint
from swarmabs_core.law_registry import LAWS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from swarmabs_config.scenario import Scenario

SCHEMA_VERSION = 1
"""Version of the provenance's fields; bags without one are of version 1 too (docs/compatibility.md)."""

_DISTRIBUTIONS = ("swarmabs_core", "ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "mcap", "numpy")


def versions() -> dict[str, str]:
    """Return the versions that a run's result may depend on; those not installed as distributions are left out."""
    found = {"python": platform.python_version()}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def plugin_versions(scenario: Scenario) -> dict[str, str]:
    """Return the versions of the packages that bring the scenario's parent controller and swarm law."""
    packages = (CONTROLLERS.package(scenario.controller.type), LAWS.package(scenario.swarm.law.type))
    return dict(package for package in packages if package is not None)


def provenance(
    scenario: Scenario,
    *,
    driver: str,
    replay: Mapping[str, object] | None = None,
    realtime: Mapping[str, object] | None = None,
    steered: bool = False,
) -> dict[str, object]:
    """Return the provenance of a run.

    Parameters
    ----------
    scenario : Scenario
        What was run.
    driver : str
        What moved the state machines: ``lockstep``, ``simulate`` or ``realtime``.
    replay : mapping, optional
        What of which bag was replayed, if it is no run of its own.
    realtime : mapping, optional
        How time became steps, and what was simulated, of a run in real time.
    steered : bool
        Whether the run could be steered: then its events say what was done to it, and its scenario does not.
    """
    own: dict[str, object] = {
        "schema": SCHEMA_VERSION,
        "scenario": scenario.name,
        "seed": scenario.seed,
        "driver": driver,
        "versions": versions() | plugin_versions(scenario),
        "machine": platform.machine(),
        "byte_order": sys.byteorder,
        "libm_fingerprint": libm_fingerprint(),
    }
    if realtime is not None:
        own["realtime"] = dict(realtime)
    if steered:
        own["steered"] = True
    return own if replay is None else own | {"replay": dict(replay)}


def provenance_json(
    scenario: Scenario,
    *,
    driver: str,
    replay: Mapping[str, object] | None = None,
    realtime: Mapping[str, object] | None = None,
    steered: bool = False,
) -> bytes:
    """Return the provenance as a bag's attachment; parameters as of `provenance`."""
    found = provenance(scenario, driver=driver, replay=replay, realtime=realtime, steered=steered)
    return json.dumps(found, indent=2, sort_keys=True).encode() + b"\n"
