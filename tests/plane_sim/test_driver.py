"""The adapter of the plane's driver."""

from __future__ import annotations

from tests.swarmabs_ros.nodes import realtime_settings_from

from plane_sim.driver import PARAMETERS, PlaneDriverConfig
from swarmabs_core.realtime.base import Schedule


def test_every_parameter_reaches_the_configuration() -> None:
    settings = realtime_settings_from(
        PARAMETERS,
        period_ns=5_000_000,
        epoch_ns=7,
        clock_tolerance=0.3,
        source="imu",
        joint="tilt",
        scale=-0.5,
        frame="axis",
        axis="+z",
        offset=0.2,
        differentiate=True,
        bandwidth=20.0,
        age_limit=0.4,
        angle_limit=0.8,
        max_rate=2.0,
        max_jump=0.01,
    )
    assert settings.made(PlaneDriverConfig) == PlaneDriverConfig(
        schedule=Schedule(5_000_000, 7),
        source="imu",
        joint="tilt",
        scale=-0.5,
        frame="axis",
        axis="+z",
        offset=0.2,
        differentiate=True,
        bandwidth=20.0,
        age_limit=0.4,
        clock_tolerance=0.3,
        angle_limit=0.8,
        max_rate=2.0,
        max_jump=0.01,
    )


def test_defaults_are_those_of_the_behaviour() -> None:
    settings = realtime_settings_from(PARAMETERS)
    assert settings.made(PlaneDriverConfig) == PlaneDriverConfig()
