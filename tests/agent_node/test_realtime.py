"""The adapter of a robot in real time."""

from __future__ import annotations

from math import inf

import pytest
from tests.swarmabs_ros.nodes import realtime_settings_from

from agent_node.realtime import PARAMETERS, make
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.realtime.agent import RealtimeAgentConfig
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.validation import Bounds
from swarmabs_core.robot_controller import Limits
from swarmabs_core.swarm_law import SwarmGains


def test_every_parameter_reaches_the_configuration() -> None:
    settings = realtime_settings_from(
        PARAMETERS,
        period_ns=5_000_000,
        epoch_ns=77,
        clock_tolerance=0.03,
        agent_id=12,
        kind="double_integrator",
        mass=0.7,
        damping=0.8,
        gravity=1.62,
        plane_length=1.4,
        gains__k=(1.0, 2.0),
        gains__kp=(3.0, 4.0),
        gains__kd=(5.0, 6.0),
        gains__ksd=7.0,
        limits__velocity=8.0,
        limits__force=9.0,
        limits__deceleration=10.0,
        swarm_mass=11.0,
        lane_margin=0.1,
        broadcast_age_limit=0.2,
        measurement_age_limit=0.3,
    )
    found = settings.made(RealtimeAgentConfig)
    assert found.lane_limit == pytest.approx(0.6)
    assert found.bounds == Bounds(1.62, 1.4, 11.0, 0.005)
    assert found == RealtimeAgentConfig(
        agent_id=12,
        kind=Kind.DOUBLE_INTEGRATOR,
        mass=0.7,
        gains=SwarmGains((1.0, 2.0), (3.0, 4.0), (5.0, 6.0), 7.0),
        schedule=Schedule(5_000_000, 77),
        gravity=1.62,
        plane_length=1.4,
        swarm_mass=11.0,
        lane_margin=0.1,
        damping=0.8,
        limits=Limits(8.0, 9.0),
        deceleration=10.0,
        broadcast_age_limit=0.2,
        measurement_age_limit=0.3,
        clock_tolerance=0.03,
        law="paper",
    )


def test_zero_is_no_limit() -> None:
    found = realtime_settings_from(PARAMETERS).made(RealtimeAgentConfig)
    assert (found.limits, found.deceleration, found.bounds.swarm_mass) == (Limits(inf, inf), inf, inf)


def test_a_single_integrator_with_damping_is_refused() -> None:
    with pytest.raises(InputError, match="damping"):
        make(realtime_settings_from(PARAMETERS, damping=0.1), None)  # type: ignore[arg-type]
