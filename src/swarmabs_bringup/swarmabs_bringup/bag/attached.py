"""What a bag has attached about its run: the scenario and the provenance."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from swarmabs_bringup.bag.errors import DamagedBagError
from swarmabs_bringup.bag.info import PROVENANCE_FILE, SCENARIO_FILE
from swarmabs_core.errors import InputError
from swarmabs_core.scenario import parse_scenario

if TYPE_CHECKING:
    from collections.abc import Sequence

    from swarmabs_bringup.bag.reader import BagReader
    from swarmabs_core.scenario import Scenario


def attached_scenario(bag: BagReader, overrides: Sequence[str] = ()) -> Scenario:
    """Return the scenario that a bag holds, of several swarms in it that of all.

    Parameters
    ----------
    bag : BagReader
        The bag.
    overrides : sequence of str
        ``a.b=value`` each.

    Raises
    ------
    InputError
        If there is none, it is not valid, or there are several swarms with different ones.
    DamagedBagError
        If its bytes are damaged.
    """
    text = bag.attachment(SCENARIO_FILE)
    if text is None:
        raise InputError(f"{bag.path} holds no scenario, so it is not known what it is a run of")
    if len(bag.swarms) > 1 and len(set(bag.attachments(SCENARIO_FILE))) > 1:
        raise InputError(f"{bag.path} holds several scenarios and does not say which of its swarms each is of")
    source = f"{bag.path}:{SCENARIO_FILE}"
    try:
        return parse_scenario(text.decode(), source=source, overrides=overrides)
    except UnicodeDecodeError as error:
        raise InputError(f"{source} is not UTF-8 text, so it is not known what it is a run of") from error


def attached_provenance(bag: BagReader) -> dict[str, Any]:
    """Return the provenance that a bag holds, empty if there is none that can be read."""
    try:
        found = json.loads(bag.attachment(PROVENANCE_FILE) or b"{}")
    except (DamagedBagError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
