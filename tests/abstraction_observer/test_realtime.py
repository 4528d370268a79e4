"""The adapter of the observer in real time."""

from __future__ import annotations

from math import inf

import pytest
from tests.swarmabs_ros.nodes import realtime_settings_from

from abstraction_observer.realtime import PARAMETERS
from swarmabs_core.errors import InputError
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.observer import RealtimeObserverConfig
from swarmabs_core.realtime.validation import Bounds


def test_every_parameter_reaches_the_configuration() -> None:
    settings = realtime_settings_from(
        PARAMETERS,
        period_ns=5_000_000,
        epoch_ns=77,
        clock_tolerance=0.03,
        members=(3, 9, 11),
        gravity=1.62,
        ksd=2.0,
        plane_length=1.4,
        swarm_mass=5.0,
        state_age_limit=0.2,
    )
    assert settings.made(RealtimeObserverConfig) == RealtimeObserverConfig(
        members=(3, 9, 11),
        schedule=Schedule(5_000_000, 77),
        gravity=1.62,
        plane_length=1.4,
        swarm_mass=5.0,
        ksd=2.0,
        state_age_limit=0.2,
        clock_tolerance=0.03,
    )
    assert settings.made(RealtimeObserverConfig).bounds == Bounds(1.62, 1.4, 5.0, 0.005)
    assert settings.made(RealtimeObserverConfig).needed == 3
    assert realtime_settings_from(PARAMETERS).made(RealtimeObserverConfig).bounds.swarm_mass == inf


@pytest.mark.parametrize(("start", "quorum", "robots"), [("wait", 0, 4), ("proceed", 0, 2), ("quorum", 3, 3)])
def test_how_many_robots_are_waited_for(start: str, quorum: int, robots: int) -> None:
    settings = realtime_settings_from(PARAMETERS, start=start, quorum=quorum)
    assert settings.made(RealtimeObserverConfig).needed == robots


@pytest.mark.parametrize("quorum", [0, 1, 5])
def test_a_quorum_that_cannot_be_is_refused(quorum: int) -> None:
    with pytest.raises(InputError, match=rf"parameter quorum: {quorum} of 4 robots"):
        realtime_settings_from(PARAMETERS, start="quorum", quorum=quorum).made(RealtimeObserverConfig)
