"""The adapter of the parent controller in real time."""

from __future__ import annotations

from typing import cast

from tests.swarmabs_ros.nodes import realtime_settings_from

from parent_controller.realtime import PARAMETERS, make
from swarmabs_core.messages import PLANE_STATE, Mode, PlaneState
from swarmabs_core.realtime.controller import RealtimeController
from swarmabs_ros.managed import RealtimeNode, RealtimeSpec

NO_NODE = cast("RealtimeNode", None)
PERIOD = 10_000_000


def made(**values: str | float) -> tuple[RealtimeSpec, RealtimeController]:
    spec = make(realtime_settings_from(PARAMETERS, **values), NO_NODE)
    assert isinstance(spec.behaviour, RealtimeController)
    return spec, spec.behaviour


def test_it_answers_the_plane_and_takes_an_operators_commands() -> None:
    spec, controller = made()
    assert spec.wakes == (PLANE_STATE,)
    assert controller._mode is Mode.RUN
    spec.services["swarm/stop"](PERIOD)
    assert controller._mode is Mode.STOP
    spec.services["swarm/reset"](2 * PERIOD)
    assert controller._mode is Mode.RESET


def test_a_fleet_begins_in_a_stop() -> None:
    assert made(start_mode="stop")[1]._mode is Mode.STOP


def test_the_age_limit_of_the_plane_and_the_tolerance_of_clocks_are_the_parameters() -> None:
    _, controller = made(plane_age_limit=0.05, clock_tolerance=0.02)
    for step, refused in ((95, False), (94, True), (102, False), (103, True)):
        events = controller.hear(PlaneState(0, step, 0.1, 0.0), 100 * PERIOD)
        assert bool(events) == refused, step
