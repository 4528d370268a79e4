"""The adapter of the plane in real time."""

from __future__ import annotations

from tests.swarmabs_ros.nodes import realtime_settings_from

from plane_sim.realtime import PARAMETERS
from swarmabs_core.plant import STEEPEST, Disturbance, Friction, Plane
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.plane import RealtimePlaneConfig
from swarmabs_core.realtime.validation import Bounds
from swarmabs_core.sensing import PlaneSensor


def test_every_parameter_reaches_the_configuration() -> None:
    settings = realtime_settings_from(
        PARAMETERS,
        period_ns=5_000_000,
        epoch_ns=77,
        members=(3, 9),
        gravity=1.62,
        inertia=0.4,
        length=1.4,
        friction=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        substep=0.002,
        angle=0.3,
        angular_velocity=0.5,
        disturbance__amplitude=0.6,
        disturbance__angular_frequency=0.7,
        end_stop=0.9,
        sensor__noise=(0.1, 0.2),
        sensor__resolution=(0.3, 0.4),
        seed=99,
    )
    assert settings.made(RealtimePlaneConfig) == RealtimePlaneConfig(
        members=(3, 9),
        schedule=Schedule(5_000_000, 77),
        plane=Plane(
            gravity=1.62,
            inertia=0.4,
            length=1.4,
            friction=Friction(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
            substep=0.002,
            angle=0.3,
            angular_velocity=0.5,
            disturbance=Disturbance(0.6, 0.7),
            end_stop=0.9,
            sensor=PlaneSensor((0.1, 0.2), (0.3, 0.4)),
        ),
        seed=99,
    )
    assert settings.made(RealtimePlaneConfig).bounds == Bounds(1.62, 1.4, period=0.005)


def test_without_end_stops_the_plane_turns_as_far_as_is_believed() -> None:
    assert realtime_settings_from(PARAMETERS).made(RealtimePlaneConfig).end_stop == STEEPEST
