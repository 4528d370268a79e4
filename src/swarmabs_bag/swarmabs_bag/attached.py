"""What is attached to a bag about its run: the scenario, and the provenance, which says with what it was made."""

from __future__ import annotations

import json
import platform
import sys
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.reader import BagReader, open_bag
from swarmabs_config.graph import REALTIME
from swarmabs_config.scenario import dump_scenario, parse_scenario
from swarmabs_config.scenario.steered import as_planned
from swarmabs_config.scenarios import find_scenario, names_bag
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.errors import InputError
from swarmabs_core.fingerprint import libm_fingerprint
from swarmabs_core.messages import BASIS, EVENTS, SwarmEvent
from swarmabs_core.swarm_law import LAWS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from swarmabs_config.scenario import Scenario

SCENARIO_FILE = "scenario.yaml"
"""Name of the attachment with the resolved scenario."""

PROVENANCE_FILE = "provenance.json"
"""Name of the attachment that says with what the run was made."""

SCHEMA_VERSION = 1
"""Version of the provenance's fields; bags without one are of version 1 too (docs/reference/compatibility.md)."""

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
    driver : str
        What moved the state machines: ``lockstep``, ``simulate`` or ``realtime``.
    replay : mapping, optional
        What was replayed from which bag, if this is the bag of a replay.
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


def attachments(scenario: Scenario, made: Mapping[str, object]) -> dict[str, bytes]:
    """Return what is attached when a bag is opened: the scenario and its `provenance`."""
    text = json.dumps(made, indent=2, sort_keys=True)
    return {SCENARIO_FILE: dump_scenario(scenario).encode(), PROVENANCE_FILE: text.encode() + b"\n"}


def scenario_of(named: str, overrides: Sequence[str] = ()) -> Scenario:
    """Load the scenario that a user has named: a built-in one, a YAML file, or that of a bag.

    Raises
    ------
    InputError
        If there is no such thing, or it is not valid.
    """
    if names_bag(named):
        return attached_scenario(open_bag(Path(named), several=True), overrides)
    return find_scenario(named, overrides)


def supply_scenario(bag: BagReader, named: str | None) -> None:
    """Take the scenario that a user has named for that of a bag without one, as other recorders write it.

    Raises
    ------
    InputError
        If the bag holds a scenario, or there is none of this name, or it is not valid.
    """
    if named is None:
        return
    if bag.attachment(SCENARIO_FILE) is not None:
        raise InputError(f"{bag.path} holds its own scenario; leave --scenario out")
    bag.supplied[SCENARIO_FILE] = dump_scenario(find_scenario(named).resolved()).encode()


def attached_scenario(bag: BagReader, overrides: Sequence[str] = (), *, steered: bool = True) -> Scenario:
    """Return the scenario that a bag holds, of several swarms in it that of all.

    Of a run that was steered it is the one in which all that was done from outside is planned: the recorded run follows
    from it. With ``steered=False`` it is the one that was started.

    Raises
    ------
    InputError
        If there is none, it is not valid, there are different ones, or what was done from outside contradicts it.
    DamagedBagError
        If its bytes are damaged.
    """
    text = bag.attachment(SCENARIO_FILE)
    if text is None:
        raise InputError(
            f"{bag.path} holds no scenario, so it is not known what it is a run of; if you have its file, "
            "verify, report, run and simulate take it with --scenario"
        )
    if bag.contradicts_itself(SCENARIO_FILE):
        of = "which of its swarms each is of" if len(bag.swarms) > 1 else "of which it is a run"
        raise InputError(f"{bag.path} holds several scenarios and does not say {of}")
    source = f"{bag.path}:{SCENARIO_FILE}"
    acted = steered and was_steered(bag) and len(bag.swarms) <= 1
    try:
        scenario = parse_scenario(text.decode(), source=source, overrides=() if acted else overrides)
    except UnicodeDecodeError as error:
        raise InputError(f"{source} is not UTF-8 text, so it is not known what it is a run of") from error
    return as_planned(scenario, _events(bag), source=source, overrides=overrides) if acted else scenario


def contradiction(bag: BagReader) -> str | None:
    """Return what is wrong with the attachments of a whole bag, which no repair can decide; errors as of `attachments`.

    A bag of several swarms may hold the scenario of each.
    """
    if len(bag.swarms) <= 1 and bag.contradicts_itself(SCENARIO_FILE):
        return "it holds several scenarios and does not say of which it is a run"
    return None


def step_period(bag: BagReader) -> int | None:
    """Return the control period of a bag's run in lockstep, ns; None in real time, and where it is not known."""
    if is_realtime(bag):
        return None
    try:
        return attached_scenario(bag, steered=False).step_ns
    except (InputError, DamagedBagError):
        return None


def event_time(bag: BagReader) -> Callable[[SwarmEvent], float]:
    """Return what gives the time (s) of an event: that of its step, or of its stamp where steps have no period."""
    period = step_period(bag)
    return lambda event: (event.stamp if period is None else event.step * period) / 1e9


def is_realtime(bag: BagReader) -> bool:
    """Tell whether a bag was recorded in real time: its provenance says so, else only such runs have a topic of inputs.

    A bag of another recorder, or a converted one, has no provenance.
    """
    made = attached_provenance(bag)
    return bool(made["driver"] == REALTIME.value) if "driver" in made else BASIS in bag.topics()


def was_steered(bag: BagReader) -> bool:
    """Say whether a bag's run could be steered."""
    return attached_provenance(bag).get("steered") is True


def _events(bag: BagReader) -> Iterator[SwarmEvent]:
    """Yield the events of a bag, as far as they can be read: what is damaged, others tell."""
    with suppress(DamagedBagError):
        for _, _, message in bag.decoded((EVENTS,)):
            if isinstance(message, SwarmEvent):
                yield message


def attached_provenance(bag: BagReader) -> dict[str, Any]:
    """Return the provenance that a bag holds, empty if there is none that can be read."""
    try:
        found = json.loads(bag.attachment(PROVENANCE_FILE) or b"{}")
    except (DamagedBagError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
