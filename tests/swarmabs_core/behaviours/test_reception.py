"""Which broadcasts a robot has when they are lost or late."""

from __future__ import annotations

from tests.swarmabs_core.helpers import broadcasts

from swarmabs_core.behaviours.reception import Reception
from swarmabs_core.faults import DelayFault, InjectedFault, LossFault, RobotFaults
from swarmabs_core.messages import Broadcast, Mode


def reception(*faults: InjectedFault) -> Reception:
    return Reception(RobotFaults(faults, 1, 3))


def newest(box: Reception) -> int | None:
    return None if box.newest is None else box.newest.abstract.step


def test_what_is_underway_in_a_lost_step_is_lost() -> None:
    """Steps 0 to 2 come two steps late; step 3 is heard at once, and in step 2 nothing is heard."""
    box = reception(InjectedFault(DelayFault(steps=2), 0, 3), InjectedFault(LossFault(probability=1.0), 2, 3))
    heard, has = [], []
    for step in range(6):
        heard.append(box.send(step, Broadcast(0, step, *broadcasts(step))))
        has.append(newest(box))
    assert heard == [True, True, False, True, True, True]
    assert has == [None, None, None, 3, 4, 5]


def test_a_stop_that_comes_after_later_broadcasts_is_obeyed() -> None:
    box = reception(InjectedFault(DelayFault(steps=2), 1, 2))
    stopped = []
    for step in range(5):
        box.send(step, Broadcast(0, step, *broadcasts(step, mode=Mode.STOP if step == 1 else Mode.RUN)))
        stopped.append((newest(box), box.stopped))
    assert stopped == [(0, False), (0, False), (2, False), (3, True), (4, True)]


def test_a_stop_that_comes_after_a_later_reset_is_over() -> None:
    """Step 1 asks for a stop and comes with step 3; step 2 resets. A reset that is as late ends a stop all the same."""
    modes = {1: Mode.STOP, 2: Mode.RESET, 5: Mode.STOP, 6: Mode.RESET}
    box = reception(InjectedFault(DelayFault(steps=2), 1, 2), InjectedFault(DelayFault(steps=3), 6, 7))
    stopped = []
    for step in range(11):
        box.send(step, Broadcast(0, step, *broadcasts(step, mode=modes.get(step, Mode.RUN))))
        stopped.append(box.stopped)
    assert [step for step, still in enumerate(stopped) if still] == [5, 6, 7, 8]
