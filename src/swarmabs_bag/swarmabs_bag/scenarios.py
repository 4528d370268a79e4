"""How a scenario is named where a bag may stand for its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from swarmabs_bag.attached import attached_scenario
from swarmabs_bag.reader import open_bag
from swarmabs_config.scenario import Scenario
from swarmabs_config.scenarios import find_scenario, names_bag


def scenario_of(named: str, overrides: Sequence[str] = ()) -> Scenario:
    """Load the scenario that a user has named.

    Parameters
    ----------
    named : str
        A built-in scenario, a YAML file, or a bag: a run's folder, its ``bag/`` or an ``.mcap`` file.
    overrides : sequence of str
        ``a.b=value`` each.

    Raises
    ------
    InputError
        If there is no such thing, or it is not valid.
    """
    if names_bag(named):
        return attached_scenario(open_bag(Path(named), several=True), overrides)
    return find_scenario(named, overrides)
