"""The adapter of the plane's driver."""

from __future__ import annotations

from tests.swarmabs_ros.nodes import settings_from

from plane_sim.driver import PARAMETERS, config
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.plane_driver import PlaneDriverConfig
from swarmabs_ros.realtime_runner import COMMON


def of_realtime() -> tuple[Parameter, ...]:
    return tuple(each for each in COMMON if each.name in {"epoch_ns", "clock_tolerance"})


def test_every_parameter_reaches_the_configuration() -> None:
    settings = settings_from(
        (*of_realtime(), *PARAMETERS),
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
    assert config(settings) == PlaneDriverConfig(
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
    settings = settings_from((*of_realtime(), *PARAMETERS))
    assert config(settings) == PlaneDriverConfig(Schedule(10_000_000, 0))
