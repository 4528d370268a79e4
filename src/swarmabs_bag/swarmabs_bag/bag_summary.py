"""Summary and reference of the run in a bag, by the arithmetic of the recorder."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Any

from swarmabs_bag.attached import attached_scenario, description_of, is_realtime
from swarmabs_bag.errors import DamagedBagError
from swarmabs_bag.reader import open_bag
from swarmabs_bag.realtime_world import law_begins, realtime_figures
from swarmabs_bag.run.figures import RunFigures, Tracking
from swarmabs_bag.run.ordering import DisorderError, recorded_steps
from swarmabs_config import configure
from swarmabs_core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from swarmabs_bag.reader import BagReader
    from swarmabs_config.scenario import Scenario
    from swarmabs_core.systems import Vector


def reference_of_bag(bag: BagReader) -> Callable[[int], float | Vector]:
    """Return the reference of a bag's run at a step: an angle (rad), or all references of another parent system.

    It includes the offsets of the angle.

    It is NaN if the bag has no valid scenario, and in real time at steps without an answer of the parent controller.
    """
    scenario = _scenario(bag)
    if scenario is None:
        return lambda _: nan
    reference, period_ns = configure.reference(scenario), scenario.step_ns
    if not is_realtime(bag):
        return lambda step: reference(step * period_ns / 1e9)
    begins = law_begins(bag)
    return lambda step: reference((step - begins[step]) * period_ns / 1e9) if step in begins else nan


def summarise_bag(path: Path, namespace: str | None) -> dict[str, Any]:
    """Return the summary of a bag's run (`RunArrays.summary`), even if its end is missing, in a single pass.

    If the messages are far out of order, all figures are None.

    Raises
    ------
    NotABagError
        If the bag no longer exists.
    DamagedBagError
        If the bag is damaged.
    """
    bag = open_bag(path, namespace=namespace, damaged=True)
    scenario = _scenario(bag)
    if scenario is not None and is_realtime(bag):
        return realtime_figures(bag, scenario).summary()
    tracking = Tracking.of(description_of(bag))
    unknown = (nan,) * len(tracking.followed)
    figures = RunFigures((lambda _: unknown) if scenario is None else configure.reference(scenario), tracking)
    try:
        for step in recorded_steps(bag.steps(), str(path), realtime=is_realtime(bag)):
            figures.add(step)
    except DisorderError:
        return dict.fromkeys(figures.summary())
    return figures.summary() | ({"digest": None} if is_realtime(bag) else {})


def _scenario(bag: BagReader) -> Scenario | None:
    try:
        return attached_scenario(bag)
    except (InputError, DamagedBagError):
        return None
