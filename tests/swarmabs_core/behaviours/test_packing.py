"""Packed broadcasts: the same messages, and nothing that a robot did not hear before."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_config import configure
from swarmabs_core.behaviours import Agent, Controller
from swarmabs_core.behaviours.base import ConflictError, StepAheadError, UnexpectedMessageError
from swarmabs_core.messages import (
    ABSTRACT_STATE,
    AUXILIARY_STATE,
    BROADCAST,
    PLANE_STATE,
    AbstractState,
    AuxiliaryState,
    Broadcast,
    DesiredAbstractState,
    Messages,
    PlaneState,
)

SCENARIO = builtin("pd_het_4")
PERIOD = SCENARIO.step_ns


def abstract(step: int, torque: float = 0.3) -> AbstractState:
    return AbstractState(step * PERIOD, step, 4, torque, 0.028, 0.01, 0.001)


def auxiliary(step: int) -> AuxiliaryState:
    return AuxiliaryState(step * PERIOD, step, 0.9, 0.01, 0.01, 0.009, 0.1, 0.2, 0.3, 0.01)


def plane(step: int) -> PlaneState:
    return PlaneState(step * PERIOD, step, 0.1, -0.02)


def desired(step: int) -> DesiredAbstractState:
    return DesiredAbstractState(step * PERIOD, step, 1, 0.3, 0.025, 0.01, 0.01, 0.01, 0.01, 0.1, 0.1)


def controller(last_step: int | None = None, *, packed: bool = True) -> Controller:
    config = configure.controller_config(SCENARIO, recording_window=0)
    return Controller(replace(config, last_step=last_step), configure.parent_controller(SCENARIO), packed=packed)


def broadcasts(answer: Messages) -> list[Broadcast]:
    return [message for message in answer if isinstance(message, Broadcast)]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0), (0, 2, 1), (2, 0, 1), (1, 0, 2)])
def test_the_broadcast_comes_with_the_last_part_in_any_order(order: tuple[int, int, int]) -> None:
    packing, alone = controller(), controller(packed=False)
    for step in range(3):
        messages = (abstract(step), auxiliary(step), plane(step))
        answers = [packing.handle(messages[index]) for index in order]
        wanted = alone.handle(plane(step))[-1]
        assert [broadcasts(answer) for answer in answers[:2]] == [[], []]
        assert broadcasts(answers[2]) == [
            Broadcast(step * PERIOD, step, messages[0], messages[1], wanted)  # type: ignore[arg-type]
        ]
        sent = [message for answer in answers for message in answer if not isinstance(message, Broadcast)]
        assert sent == [wanted]  # the third broadcast itself is published all the same


def test_it_waits_for_the_plane_and_then_for_the_observer() -> None:
    packing = controller(last_step=0)
    assert packing.awaits() == (PLANE_STATE,)
    packing.handle(plane(0))
    assert packing.awaits() == (ABSTRACT_STATE,)
    assert packing.missing() == (0, ("abstraction_observer",))
    packing.handle(abstract(0))
    assert packing.awaits() == (AUXILIARY_STATE,)
    assert len(broadcasts(packing.handle(auxiliary(0)))) == 1
    assert packing.awaits() == ()  # only now: the last step has a broadcast, too


def test_repetitions_change_nothing_and_contradictions_are_refused() -> None:
    packing = controller()
    packing.handle(abstract(0))
    assert packing.handle(abstract(0)) == ()
    with pytest.raises(ConflictError, match="abstract_state"):
        packing.handle(abstract(0, torque=0.4))
    packing.handle(auxiliary(0))
    packing.handle(plane(0))
    assert packing.handle(abstract(0, torque=0.5)) == ()  # outdated: that step is over
    with pytest.raises(StepAheadError, match="abstract_state: step 1 expected, 2 received"):
        packing.handle(abstract(2))


@pytest.mark.parametrize("index", range(4))
def test_a_robot_does_the_same_with_packed_broadcasts(index: int) -> None:
    config = configure.agent_configs(SCENARIO)[index]
    alone, packed = Agent(config), Agent(config, packed=True)
    assert packed.needs == packed.awaits() == (BROADCAST,)
    assert packed.start() == alone.start()
    for step in range(5):
        parts = (abstract(step), auxiliary(step), desired(step))
        expected = tuple(answer for part in parts for answer in alone.handle(part))
        message = Broadcast(step * PERIOD, step, *parts)
        assert packed.handle(message) == expected
        assert packed.handle(message) == ()  # repeated
        assert packed.missing() == (step + 1, ("swarm/broadcast",))


def test_a_robot_that_feels_gravity_still_waits_for_the_plane() -> None:
    config = replace(configure.agent_configs(SCENARIO)[2], feels_gravity=True)
    packed = Agent(config, packed=True)
    assert packed.needs == (BROADCAST, PLANE_STATE)
    packed.start()
    assert packed.handle(Broadcast(0, 0, abstract(0), auxiliary(0), desired(0))) == ()
    assert packed.awaits() == (PLANE_STATE,)
    assert len(packed.handle(plane(0))) == 1


def test_a_robot_with_packed_broadcasts_refuses_single_ones() -> None:
    packed = Agent(configure.agent_configs(SCENARIO)[0], packed=True)
    with pytest.raises(UnexpectedMessageError):
        packed.handle(abstract(0))
