"""The adapter of the simulated plane."""

from __future__ import annotations

from math import inf

from tests.swarmabs_ros.nodes import settings_from

from plane_sim.node import PARAMETERS, make
from swarmabs_config.graph import LOCKSTEP, PLANE
from swarmabs_core.behaviours import Plane, PlaneConfig
from swarmabs_core.membership import Change, ChangeKind
from swarmabs_core.messages import AGENT_STATE, EVENTS, PLANE_STATE
from swarmabs_core.plant import Disturbance, Friction
from swarmabs_core.sensing import PlaneSensor
from swarmabs_ros.status import StatusChannel


def test_every_parameter_reaches_the_configuration() -> None:
    found = settings_from(
        PARAMETERS,
        period_ns=5_000_000,
        last_step=77,
        members=(2, 9),
        schedule=("leave 9 5",),
        gravity=1.62,
        inertia=0.7,
        length=1.4,
        friction=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        substep=0.0005,
        angle=-0.2,
        angular_velocity=0.3,
        disturbance__amplitude=0.4,
        disturbance__angular_frequency=0.6,
        end_stop=0.8,
        sensor__noise=(0.1, 0.2),
        sensor__resolution=(0.3, 0.4),
        seed=5,
        actuator_lag=0.9,
    ).made(PlaneConfig)
    assert found.members == (2, 9)
    assert (found.period_ns, found.last_step, found.plane.substep) == (5_000_000, 77, 0.0005)
    assert (found.plane.gravity, found.plane.inertia, found.plane.length) == (1.62, 0.7, 1.4)
    assert found.plane.friction == Friction(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert (found.plane.angle, found.plane.angular_velocity) == (-0.2, 0.3)
    assert found.plane.disturbance == Disturbance(0.4, 0.6)
    assert found.schedule == (Change(5, 9, ChangeKind.LEAVE),)
    assert found.plane.sensor == PlaneSensor((0.1, 0.2), (0.3, 0.4))
    assert (found.plane.end_stop, found.seed, found.actuator_lag) == (0.8, 5, 0.9)


def test_no_end_stop_and_a_perfect_sensor_by_default() -> None:
    found = settings_from(PARAMETERS).made(PlaneConfig)
    assert found.plane.end_stop == inf
    assert found.plane.sensor.perfect


def test_it_hears_robots_and_events_and_says_where_the_plane_is() -> None:
    settings = settings_from(PARAMETERS)
    assert isinstance(make(settings, StatusChannel("plane_sim")).behaviour, Plane)
    ends = settings.endpoints(PLANE, LOCKSTEP)
    assert set(ends.publications) == {PLANE_STATE, EVENTS}
    assert set(ends.subscriptions) == {AGENT_STATE, EVENTS}
    assert ends.subscriptions[EVENTS].reliability == "reliable", "a lost event of a death would stall the plane"


def test_a_large_swarm_has_room_to_wait_in() -> None:
    settings = settings_from(PARAMETERS, members=tuple(range(1, 201)))
    assert settings.endpoints(PLANE, LOCKSTEP).subscriptions[AGENT_STATE].depth >= 400
