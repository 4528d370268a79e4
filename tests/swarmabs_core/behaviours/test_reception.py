"""Which broadcasts a robot has when they are lost or late."""

from dataclasses import replace

import pytest
from tests.swarmabs_core.helpers import broadcasts as parts, builtin

from swarmabs_config import configure
from swarmabs_core import messages as msg
from swarmabs_core.behaviours import Agent, Controller
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError
from swarmabs_core.behaviours.reception import Reception
from swarmabs_core.faults import DelayFault, InjectedFault, LossFault, RobotFaults

SCENARIO = builtin("pd_het_4")
PERIOD = SCENARIO.step_ns


def late(steps: int, first: int, end: int) -> InjectedFault:
    return InjectedFault(DelayFault(steps=steps), first, end)


@pytest.mark.parametrize(
    ("faults", "modes", "lost", "newest", "stopped"),
    [
        # What is underway in a lost step is lost; step 3 is heard at once.
        ((late(2, 0, 3), InjectedFault(LossFault(probability=1.0), 2, 3)), {}, [2], [None, None, None, 3, 4, 5], []),
        # A stop that comes after later broadcasts is obeyed,
        ((late(2, 1, 2),), {1: msg.Mode.STOP}, [], [0, 0, 2, 3, 4], [3, 4]),
        # but not after a later reset, and a reset that is as late ends a stop all the same.
        (
            (late(2, 1, 2), late(3, 6, 7)),
            {1: msg.Mode.STOP, 2: msg.Mode.RESET, 5: msg.Mode.STOP, 6: msg.Mode.RESET},
            [],
            [0, 0, 2, 3, 4, 5, 5, 7, 8, 9, 10],
            [5, 6, 7, 8],
        ),
    ],
)
def test_broadcasts_that_are_lost_or_late(
    faults: tuple[InjectedFault, ...],
    modes: dict[int, msg.Mode],
    lost: list[int],
    newest: list[int],
    stopped: list[int],
) -> None:
    box = Reception(RobotFaults(faults, 1, 3))
    for step, expected in enumerate(newest):
        heard = box.send(step, msg.Broadcast(0, step, *parts(step, mode=modes.get(step, msg.Mode.RUN))))
        assert heard == (step not in lost)
        assert (box.newest.abstract.step if box.newest else None, box.stopped) == (expected, step in stopped)


def plane(step: int) -> msg.PlaneState:
    return msg.PlaneState(step * PERIOD, step, 0.1, -0.02)


def controller(last_step: int | None = None) -> Controller:
    config = replace(configure.controller_config(SCENARIO, recording_window=0), last_step=last_step)
    return Controller(config, packed=True)


def test_a_controller_that_packs_waits_for_plane_and_observer_and_refuses_contradictions() -> None:
    packing = controller(last_step=0)
    assert packing.awaits() == (msg.PLANE_STATE,)
    packing.handle(plane(0))
    assert packing.awaits() == (msg.ABSTRACT_STATE,)
    assert packing.missing() == (0, ("abstraction_observer",))
    packing.handle(parts(0)[0])
    assert packing.awaits() == (msg.AUXILIARY_STATE,)
    assert [type(answer) for answer in packing.handle(parts(0)[1])][-1] is msg.Broadcast
    assert packing.awaits() == ()  # only now: the last step has a broadcast, too
    packing = controller()
    packing.handle(parts(0)[0])
    assert packing.handle(parts(0)[0]) == ()
    with pytest.raises(ConflictError, match="abstract_state"):
        packing.handle(parts(0, torque=0.4)[0])
    packing.handle(parts(0)[1])
    packing.handle(plane(0))
    assert packing.handle(parts(0, torque=0.5)[0]) == ()  # outdated: that step is over
    with pytest.raises(StepAheadError, match="abstract_state: step 1 expected, 2 received"):
        packing.handle(parts(2)[0])


def test_a_robot_with_packed_broadcasts_does_the_same_and_refuses_single_ones() -> None:
    config = configure.agent_configs(SCENARIO)[3]
    alone, packed = Agent(config), Agent(config, packed=True)
    assert packed.needs == packed.awaits() == (msg.BROADCAST,)
    assert packed.start() == alone.start()
    for step in range(3):
        message = msg.Broadcast(step * PERIOD, step, *parts(step))
        assert packed.handle(message) == tuple(answer for part in parts(step) for answer in alone.handle(part))
        assert packed.handle(message) == (), "repeated"
        assert packed.missing() == (step + 1, ("swarm/broadcast",))
    with pytest.raises(UnexpectedMessageError):
        packed.handle(parts(0)[0])
    config = replace(configure.agent_configs(SCENARIO)[2], feels_gravity=True)
    packed = Agent(config, packed=True)
    assert packed.needs == (msg.BROADCAST, msg.PLANE_STATE)
    packed.start()
    assert packed.handle(msg.Broadcast(0, 0, *parts(0))) == ()
    assert packed.awaits() == (msg.PLANE_STATE,)
    assert len(packed.handle(plane(0))) == 1
