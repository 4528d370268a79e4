"""The scenario of a steered run, with its steering as planned faults."""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml

from swarmabs_config import configure
from swarmabs_core.declaration import tree_of
from swarmabs_core.errors import InputError
from swarmabs_core.events import EventCode, code_of
from swarmabs_core.faults import FAULTS, Fault, JoinFault, MembershipFault, SettingFault
from swarmabs_core.membership import UNPLANNED, Change, ChangeKind
from swarmabs_core.messages import EventKind, SwarmEvent

from .loader import parse_scenario

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from swarmabs_config.model.scenario import Scenario

_SETTINGS = {kind: fault for kind, fault in FAULTS.items() if issubclass(fault, SettingFault)}
_ENDING = {kind: fault for kind, fault in FAULTS.items() if issubclass(fault, MembershipFault)}
_ENDS = {
    EventCode.KILLED: ChangeKind.KILL,
    EventCode.FROZEN: ChangeKind.FREEZE,
    EventCode.REMOVED: ChangeKind.REMOVE,
}


def as_planned(
    scenario: Scenario,
    events: Iterable[SwarmEvent],
    *,
    ends: Iterable[Change] = (),
    source: str = "scenario of the steered run",
    overrides: Sequence[str] = (),
) -> Scenario:
    """Return the scenario that plans what steering did to a run.

    Parameters
    ----------
    scenario : Scenario
        The scenario of the run.
    events : iterable of SwarmEvent
        The events of the run; those of planned faults change nothing.
    ends : iterable of Change
        Further unplanned ends of robots.
    source : str
        Its name in errors.
    overrides : sequence of str
        Overrides ``a.b=v`` of the returned scenario.

    Raises
    ------
    InputError
        If an event cannot be planned, or contradicts the scenario.
    """
    settings = {kind: dict(configure.step_changes(scenario, kind)) for kind in _SETTINGS}
    joined: dict[int, int] = {}
    ended = {change.agent_id: change for change in ends}
    absent = {change.agent_id for change in configure.schedule(scenario) if change.step == UNPLANNED}
    for event in events:
        code = code_of(event)
        if code is EventCode.STEERING:
            raise InputError(
                f"{source}: this version does not know the setting {event.detail!r:.80}, which was changed at step "
                f"{event.step}",
                "update swarmabs",
            )
        if code in (EventCode.REFERENCE, EventCode.DISTURBANCE):
            settings[code.text][event.step] = event.value
        elif event.kind == EventKind.JOINED and event.agent_id in absent:
            joined[event.agent_id] = event.step
        elif code in _ENDS:
            ended[event.agent_id] = Change(event.step - 1, event.agent_id, _ENDS[code])
    faults = _planned(scenario, settings, joined, ended)
    if faults is None and not overrides:
        return scenario
    text = scenario.model_dump(mode="json", by_alias=True)
    if faults is not None:
        text["faults"] = faults
    return parse_scenario(yaml.safe_dump(text), source=source, overrides=overrides)


def _planned(
    scenario: Scenario, settings: dict[str, dict[int, float]], joined: dict[int, int], ended: dict[int, Change]
) -> list[dict[str, object]] | None:
    """Return the faults of the scenario and of the steering; None if nothing was steered."""

    def at(step: int) -> float:
        return step * scenario.step_ns / 1e9

    steered = {kind for kind, values in settings.items() if values != dict(configure.step_changes(scenario, kind))}
    schedule = set(configure.schedule(scenario))
    ended = {agent_id: change for agent_id, change in ended.items() if change not in schedule}
    if not (steered or joined or ended):
        return None
    joins = {change.agent_id: change.step for change in schedule if change.kind is ChangeKind.JOIN} | joined
    # Who did not even answer in its first step has never taken part.
    absent = {agent_id for agent_id, change in ended.items() if change.step < joins.get(agent_id, 0)}
    faults: list[Fault] = []
    for fault in scenario.faults:
        if isinstance(fault, JoinFault) and fault.agent in absent:
            faults.append(JoinFault(at=None, agent=fault.agent))
        elif isinstance(fault, JoinFault) and fault.agent in joined:
            faults.append(JoinFault(at=at(joined[fault.agent]), agent=fault.agent))
        elif isinstance(fault, JoinFault) or not (
            fault.kind in steered or (isinstance(fault, MembershipFault) and fault.agent in ended)
        ):
            faults.append(fault)
    for kind in sorted(steered):
        setting = _SETTINGS[kind]
        faults += [setting(at=at(step), **{setting.sets: value}) for step, value in sorted(settings[kind].items())]
    for change in sorted(change for change in ended.values() if change.agent_id not in absent):
        faults.append(_ENDING[change.kind.value](at=at(change.step), agent=change.agent_id))
    return [{"kind": fault.kind, **tree_of(fault)} for fault in faults]
