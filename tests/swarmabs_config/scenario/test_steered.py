"""What steering did to a run, as planned faults at the steps of its events."""

from tests.swarmabs_core.helpers import builtin

from swarmabs_config import configure
from swarmabs_config.scenario.steered import as_planned
from swarmabs_core.events import EventCode
from swarmabs_core.membership import UNPLANNED, Change, ChangeKind
from swarmabs_core.messages import SwarmEvent
from swarmabs_core.steering import DISTURBANCE, REFERENCE, StepChange


def event(code: EventCode, step: int, agent_id: int = 0, value: float = 0.0) -> SwarmEvent:
    return SwarmEvent(0, step, agent_id, code.kind, value, code.text)


def test_steering_becomes_faults_at_the_same_steps() -> None:
    scenario = builtin(
        "pd_het_4", "faults=[{kind: join, at: null, agent: 4}, {kind: disturbance, at: 0.1, torque: 0.1}]"
    )
    events = (
        event(EventCode.DISTURBANCE, 10, value=0.1),  # as planned
        event(EventCode.REFERENCE, 15, value=0.02),
        event(EventCode.REFERENCE, 25, value=0.03),
        event(EventCode.JOINED, 20, agent_id=4),
        event(EventCode.KILLED, 31, agent_id=3),  # the robot was there in step 30 for the last time
    )
    planned = as_planned(scenario, events)
    assert configure.schedule(planned) == (Change(20, 4, ChangeKind.JOIN), Change(30, 3, ChangeKind.KILL))
    assert configure.step_changes(planned, REFERENCE) == (StepChange(15, 0.02), StepChange(25, 0.03))
    assert configure.step_changes(planned, DISTURBANCE) == (StepChange(10, 0.1),)
    assert as_planned(scenario, events[:1]) is scenario


def test_who_was_silent_in_its_first_step_has_never_joined() -> None:
    faults = "[{kind: join, at: 0.2, agent: 4}, {kind: join, at: null, agent: 3}, {kind: kill, at: 0.5, agent: 2}]"
    scenario, order = builtin("pd_het_4", f"faults={faults}"), event(EventCode.JOINED, 30, agent_id=3)
    ends = [Change(19, 4, ChangeKind.KILL), Change(29, 3, ChangeKind.KILL)]
    planned = as_planned(scenario, [order], ends=ends)
    never = (Change(UNPLANNED, 3, ChangeKind.JOIN), Change(UNPLANNED, 4, ChangeKind.JOIN))
    assert configure.schedule(planned) == (Change(50, 2, ChangeKind.KILL), *never)
