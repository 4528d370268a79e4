"""What a bag has attached about its run: the scenario and the provenance."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from swarmabs_bag.errors import DamagedBagError
from swarmabs_config.scenario import parse_scenario
from swarmabs_config.scenario.steered import as_planned
from swarmabs_core.errors import InputError
from swarmabs_core.messages import EVENTS, SwarmEvent

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario

SCENARIO_FILE = "scenario.yaml"
"""Name of the attachment with the resolved scenario."""

PROVENANCE_FILE = "provenance.json"
"""Name of the attachment that says with what the run was made."""

REALTIME = "realtime"
"""What the provenance of a run in real time calls what moved its state machines."""


def attached_scenario(bag: BagReader, overrides: Sequence[str] = (), *, steered: bool = True) -> Scenario:
    """Return the scenario that a bag holds, of several swarms in it that of all.

    Of a run that was steered it is the one in which all that was done from outside is planned: the recorded run follows
    from it.

    Parameters
    ----------
    bag : BagReader
        The bag.
    overrides : sequence of str
        ``a.b=value`` each.
    steered : bool
        Whether what was done from outside is part of it.

    Raises
    ------
    InputError
        If there is none, it is not valid, there are different ones, or what was done from outside contradicts it.
    DamagedBagError
        If its bytes are damaged.
    """
    text = bag.attachment(SCENARIO_FILE)
    if text is None:
        raise InputError(f"{bag.path} holds no scenario, so it is not known what it is a run of")
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


def step_period(bag: BagReader) -> int | None:
    """Return the control period of a bag's run in lockstep, ns; None in real time, and where it is not known."""
    if attached_provenance(bag).get("driver") == REALTIME:
        return None
    try:
        return attached_scenario(bag, steered=False).step_ns
    except (InputError, DamagedBagError):
        return None


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
