"""Drives by name, and those that packages bring."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.plugin_packages import install

from swarmabs_core.drive import DoubleIntegratorDrive
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.drives import DRIVES, Body, Measurement, SimulatedDrive

MS = 1_000_000
BODY = Body(3, Kind.DOUBLE_INTEGRATOR, Schedule(10 * MS), 0.5, 0.8, position=0.1, velocity=-0.2)

STANDING = """
    from swarmabs_core.parameters import Parameter
    from swarmabs_core.realtime.drives import DriveType
    from swarmabs_core.realtime.drives import Measurement


    class Standing:
        def __init__(self, settings, body):
            self.place = settings["place"] + body.position

        def read(self, now):
            return Measurement(now, self.place, 0.0)

        def write(self, command, now):
            pass

        def stop(self):
            pass


    PART = DriveType("standing", (Parameter("place", 0.0, "where it stands, m", minimum=-1.0),), Standing)
"""


def test_a_simulated_body_is_that_of_the_robot() -> None:
    drive = DRIVES.make("simulated", {}, BODY)
    assert isinstance(drive, SimulatedDrive)
    drive.read(0)
    drive.write(0.3, 0)
    expected = DoubleIntegratorDrive.of(0.01, 0.5, 0.8).advance(0.1, -0.2, 0.3)
    assert drive.read(10 * MS) == Measurement(10 * MS, *expected)


def test_a_package_brings_a_drive(packages: Path) -> None:
    install(packages, "drive", "standing", STANDING)
    assert DRIVES.make("standing", {"place": 0.25}, BODY).read(7) == Measurement(7, 0.35, 0.0)
    assert DRIVES.package("standing") == ("test-standing", "1.5")
    assert set(DRIVES) == {"simulated", "topic", "standing"}
    with pytest.raises(InputError, match="give at least -1"):
        DRIVES.make("standing", {"place": -2.0}, BODY)


def test_what_cannot_stop_is_no_drive(packages: Path) -> None:
    install(packages, "drive", "standing", STANDING.replace("def stop", "def rest"))
    with pytest.raises(InputError, match="has no method stop; repair the package"):
        DRIVES.make("standing", {}, BODY)


def test_an_unknown_drive_is_named_with_those_there_are() -> None:
    with pytest.raises(InputError, match="no drive 'topics'; there are simulated, topic"):
        DRIVES.find("topics")
