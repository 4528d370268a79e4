"""Attachments that describe the run of a bag: the scenario, and the provenance with versions and machine."""

from __future__ import annotations

import json
import platform
import sys
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmabs_bag.errors import DamagedBagError, UnknownTypeError
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_bag.run.metadata import REPAIRED_KEY
from swarmabs_config.configure import plugins
from swarmabs_config.graph import REALTIME
from swarmabs_config.installation import own_version
from swarmabs_config.scenario import dump_scenario, parse_scenario
from swarmabs_config.scenario.steered import as_planned
from swarmabs_config.scenarios import find_scenario, names_bag
from swarmabs_core.arithmetic import ARITHMETIC, FORMER
from swarmabs_core.errors import InputError, MalformedMessageError
from swarmabs_core.messages import BASIS, EVENTS, SYSTEM, SwarmEvent, SystemDescription
from swarmabs_core.systems import PLANE_TABLES, SystemTables

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from swarmabs_config.scenario import Scenario

SCENARIO_FILE = "scenario.yaml"
"""Name of the attachment with the resolved scenario."""

PROVENANCE_FILE = "provenance.json"
"""Name of the attachment with versions, machine and driver of the run."""

SCHEMA_VERSION = 1
"""Version of the provenance's fields; bags without it have version 1 (docs/reference/compatibility.md)."""

MERGED = "merged"
"""Key in the provenance of a merged bag, with an entry for each of the bags that it is made of."""

UNDECIDED = "it contains several scenarios and does not state which one was run"
"""The `contradiction` of a bag that no repair can decide."""

_DISTRIBUTIONS = ("ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "mcap", "numpy")


def versions(scenario: Scenario | None = None) -> dict[str, str]:
    """Return the versions that may affect the result of a run, of all packages installed as distributions.

    With a scenario, those that provide its parent system, its controller and its swarm law are among them.
    """
    installed = {"python": platform.python_version()}
    if own := own_version():
        installed["swarmabs_core"] = own
    for name in _DISTRIBUTIONS:
        try:
            installed[name] = version(name)
        except PackageNotFoundError:
            continue
    packages = [] if scenario is None else [registry.package(name) for registry, name in plugins(scenario)]
    return installed | dict(package for package in packages if package is not None)


def provenance(
    scenario: Scenario,
    *,
    driver: str,
    realtime: Mapping[str, object] | None = None,
    packed: bool = False,
    steered: bool = False,
) -> dict[str, object]:
    """Return the provenance of a run.

    Parameters
    ----------
    driver : str
        What drove the state machines: ``lockstep``, ``simulate`` or ``realtime``.
    realtime : mapping, optional
        Mapping from time to steps, and the simulated parts, of a run in real time.
    packed : bool
        Whether the nodes sent packed messages.
    steered : bool
        Whether the run was steerable: then requests are in its events, and not in its scenario.
    """
    own: dict[str, object] = {
        "schema": SCHEMA_VERSION,
        "scenario": scenario.name,
        "seed": scenario.seed,
        "driver": driver,
        "versions": versions(scenario),
        "machine": platform.machine(),
        "byte_order": sys.byteorder,
        "arithmetic": ARITHMETIC,
    }
    if realtime is not None:
        own["realtime"] = dict(realtime)
    return own | {name: True for name, holds in (("packed", packed), ("steered", steered)) if holds}


def arithmetic_of(stated: Mapping[str, object]) -> int | None:
    """Return the number of the arithmetic that a provenance states; None if it states none.

    Bags of the former arithmetic contain a fingerprint of the mathematical library instead.
    """
    number = stated.get("arithmetic", FORMER if "libm_fingerprint" in stated else None)
    return number if isinstance(number, int) else None


def attachments(scenario: Scenario, provenance: Mapping[str, object]) -> dict[str, bytes]:
    """Return the attachments of a new bag: the scenario and its `provenance`."""
    text = json.dumps(provenance, indent=2, sort_keys=True)
    return {SCENARIO_FILE: dump_scenario(scenario).encode(), PROVENANCE_FILE: text.encode() + b"\n"}


def scenario_of(named: str, overrides: Sequence[str] = ()) -> Scenario:
    """Load a scenario given by a user: a built-in one, a YAML file, or that of a bag.

    Raises
    ------
    InputError
        If it does not exist or is not valid.
    """
    if names_bag(named):
        return attached_scenario(open_bag(Path(named), several=True), overrides)
    return find_scenario(named, overrides)


def supply_scenario(bag: BagReader, named: str | None) -> None:
    """Supply a scenario for a bag without one, as written by other recorders.

    Raises
    ------
    InputError
        If the bag contains a scenario, or the named one does not exist or is not valid.
    """
    if named is None:
        return
    if bag.attachment(SCENARIO_FILE) is not None:
        raise InputError(f"{bag.path} contains a scenario; leave out --scenario")
    bag.supplied[SCENARIO_FILE] = dump_scenario(find_scenario(named).resolved()).encode()


def attached_scenario(bag: BagReader, overrides: Sequence[str] = (), *, steered: bool = True) -> Scenario:
    """Return the scenario of a bag; several swarms must share it.

    For a steered run, it includes all requests as planned faults, so that the recorded run follows from it. With
    ``steered=False`` it is the scenario at the start.

    Raises
    ------
    InputError
        If it is missing, invalid, ambiguous, or contradicted by the recorded requests.
    DamagedBagError
        If its bytes are damaged.
    """
    text = bag.attachment(SCENARIO_FILE)
    if text is None:
        raise InputError(
            f"{bag.path} contains no scenario; if you have its file, give it to verify, report, run or simulate with "
            "--scenario"
        )
    if bag.contradicts_itself(SCENARIO_FILE):
        of = "which swarm each belongs to" if len(bag.swarms) > 1 else "which one was run"
        raise InputError(f"{bag.path} contains several scenarios and does not state {of}")
    source = f"{bag.path}:{SCENARIO_FILE}"
    acted = steered and was_steered(bag) and len(bag.swarms) <= 1
    scenario: Scenario
    try:
        scenario = parse_scenario(text.decode(), source=source, overrides=() if acted else overrides, recorded=True)
    except UnicodeDecodeError as error:
        raise InputError(f"{source} is not UTF-8 text, so its scenario is unknown") from error
    if acted:
        scenario = as_planned(scenario, events_in(bag), source=source, overrides=overrides)
    return scenario


def contradiction(bag: BagReader) -> str | None:
    """Return a contradiction between the attachments of an intact bag, which no repair can resolve.

    A bag of several swarms may contain a scenario for each. Errors as for `attachments`.
    """
    if len(bag.swarms) <= 1 and bag.contradicts_itself(SCENARIO_FILE):
        return UNDECIDED
    return None


def step_period(bag: BagReader) -> int | None:
    """Return the control period of a bag's run in lockstep, ns; None in real time, or if unknown."""
    if is_realtime(bag):
        return None
    try:
        return int(attached_scenario(bag, steered=False).step_ns)
    except (InputError, DamagedBagError):
        return None


def event_time(bag: BagReader) -> Callable[[SwarmEvent], float]:
    """Return a function from an event to its time (s): that of its step or, without a period, of its stamp."""
    period = step_period(bag)
    return lambda event: (event.stamp if period is None else event.step * period) / 1e9


def description_of(bag: BagReader) -> SystemTables:
    """Return the names and units of a bag's parent system, whose package need not be installed.

    Raises `DamagedBagError` if they are missing or damaged.
    """
    if not bag.family.once:
        return PLANE_TABLES
    for _, _, message in bag.decoded((SYSTEM,)):
        if isinstance(message, SystemDescription):
            try:
                return SystemTables.read(message.description)
            except MalformedMessageError as error:
                raise DamagedBagError(f"{bag.path}: {error}") from error
    raise DamagedBagError(f"{bag.path} does not describe its parent system: it has no message on /{SYSTEM.name}")


def is_realtime(bag: BagReader) -> bool:
    """Return whether a bag was recorded in real time, according to its provenance.

    A bag of another recorder, or a converted one, has no provenance; then the topic of inputs decides, which only runs
    in real time have.
    """
    stated = attached_provenance(bag)
    return bool(stated["driver"] == REALTIME.value) if "driver" in stated else BASIS in bag.topics()


def was_steered(bag: BagReader) -> bool:
    """Return whether the run of a bag was steerable."""
    return attached_provenance(bag).get("steered") is True


def events_in(bag: BagReader) -> Iterator[SwarmEvent]:
    """Yield the readable events of a bag; other readers report the damage."""
    if not any(channel.message_count for channel in bag.channels if channel.topic is EVENTS):
        return  # without reading all of the bag
    with suppress(DamagedBagError, UnknownTypeError):
        for _, _, message in bag.decoded((EVENTS,)):
            if isinstance(message, SwarmEvent):
                yield message


def lost(bag: BagReader) -> str | None:
    """Return what repairs could not recover of a bag; of a merged one, only if each of its bags lost some."""
    if (own := bag.custom_data().get(REPAIRED_KEY)) is not None:
        return own
    merged = attached_provenance(bag).get(MERGED)
    losses = [entry.get("repaired") for entry in merged if isinstance(entry, dict)] if isinstance(merged, list) else []
    return "; ".join(map(str, losses)) if losses and all(losses) else None


def attached_provenance(bag: BagReader) -> dict[str, Any]:
    """Return the provenance of a bag, empty if missing or unreadable."""
    try:
        document = json.loads(bag.attachment(PROVENANCE_FILE) or b"{}")
    except (DamagedBagError, ValueError, RecursionError):
        return {}
    return document if isinstance(document, dict) else {}
