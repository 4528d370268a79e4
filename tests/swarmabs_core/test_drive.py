"""Drives by name, and those that packages bring."""

from fractions import Fraction
from math import factorial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm
from tests.plugin_packages import install

from swarmabs_core.drive import DoubleIntegratorDrive, Lag, SingleIntegratorDrive
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Kind
from swarmabs_core.realtime.base import Schedule
from swarmabs_core.realtime.drives import DRIVES, Body, Measurement, SimulatedDrive

masses = st.floats(0.05, 5.0)
dampings = st.one_of(st.just(0.0), st.floats(1e-12, 1e-3), st.floats(1e-3, 50.0))
periods = st.floats(1e-4, 0.2)
states = st.floats(-2.0, 2.0)


def exact_gains(z: Fraction) -> tuple[float, float]:
    """(e^z - 1)/z and (e^z - 1 - z)/z^2 in rational arithmetic, for |z| <= 2."""
    phi1 = sum(z**n / factorial(n + 1) for n in range(25))
    phi2 = sum(z**n / factorial(n + 2) for n in range(25))
    return float(phi1), float(phi2)


def test_single_integrator_moves_at_its_command_and_no_lag_is_none() -> None:
    assert SingleIntegratorDrive(0.01).advance(0.1, 0.2, -0.3) == (0.1 - 0.3 * 0.01, -0.3)
    assert Lag.of(Kind.DOUBLE_INTEGRATOR, 0.0, 0.01, 1.0, 0.0) is None


@settings(max_examples=40)
@given(periods, masses, dampings, states, states, states)
def test_double_integrator_is_a_matrix_exponential(h: float, m: float, c: float, p: float, v: float, u: float) -> None:
    augmented = np.array([[0.0, 1.0, 0.0], [0.0, -c / m, 1.0 / m], [0.0, 0.0, 0.0]])
    expected = expm(augmented * h)[:2] @ [p, v, u]
    assert DoubleIntegratorDrive.of(h, m, c).advance(p, v, u) == pytest.approx(expected, rel=1e-11, abs=1e-12)


@settings(max_examples=40)
@given(st.one_of(st.just(0.0), st.floats(1e-300, 1e-10), st.floats(1e-10, 2.0)))
def test_gains_keep_their_digits_for_any_damping(z: float) -> None:
    drive = DoubleIntegratorDrive.of(1.0, 1.0, z)
    phi1, phi2 = exact_gains(Fraction(-z))
    assert drive.velocity_to_position == pytest.approx(phi1, rel=1e-15)
    assert drive.force_to_velocity == pytest.approx(phi1, rel=1e-15)
    assert drive.force_to_position == pytest.approx(phi2, rel=1e-14)
    assert drive.decay == pytest.approx(1.0 - z * phi1, rel=1e-13)


@pytest.mark.parametrize("h", [0.001, 0.1, 0.49, 0.51, 3.0])
def test_lag_keeps_its_digits_where_lag_and_drag_are_equally_fast(h: float) -> None:
    """In rational arithmetic: both time constants are 0.5 s, or differ by a little."""
    for offset in (0.0, 1e-16, 1e-12, 1e-8, 1e-4):
        a, b = Fraction(-h) / Fraction(0.5), Fraction(-(1.0 + offset) * 1.0 * h) / Fraction(0.5)
        homogeneous = [sum(a**i * b ** (n - i) for i in range(n + 1)) for n in range(50)]
        lag = Lag.of(Kind.DOUBLE_INTEGRATOR, 0.5, h, 0.5, 1.0 + offset)
        first = sum(term / factorial(n + 1) for n, term in enumerate(homogeneous))
        second = sum(term / factorial(n + 2) for n, term in enumerate(homogeneous))
        assert lag.gap_to_velocity == pytest.approx(float(first) * h / 0.5, rel=1e-13)
        assert lag.gap_to_position == pytest.approx(float(second) * h * h / 0.5, rel=1e-13)


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


def test_a_simulated_body_is_that_of_the_robot_and_coasts_until_it_is_told_something() -> None:
    drive, ideal, motion = DRIVES.make("simulated", {}, BODY), DoubleIntegratorDrive.of(0.01, 0.5, 0.8), (0.1, -0.2)
    assert isinstance(drive, SimulatedDrive)
    drive.read(0)
    for step, command in enumerate((0.0, 0.3), start=1):
        if command:
            drive.write(command, 0)
        motion = ideal.advance(*motion, command)
        assert drive.read(step * 10 * MS) == Measurement(step * 10 * MS, *motion)


@pytest.mark.parametrize("kind", [Kind.SINGLE_INTEGRATOR, Kind.DOUBLE_INTEGRATOR])
def test_a_simulated_body_stops_by_itself_when_commands_cease(kind: Kind) -> None:
    """The robots that go on take a silent one for one at rest: 0.2 s after the last command it is."""
    body = Body(3, kind, Schedule(10 * MS), 0.5, position=0.1)
    often, once = SimulatedDrive(body), SimulatedDrive(body)
    for drive in (often, once):
        drive.read(0)
        drive.write(0.4, 0)
    last = [often.read(step * 10 * MS) for step in range(1, 21)][-1]
    assert last.position > 0.1
    assert once.read(500 * 10 * MS) == Measurement(500 * 10 * MS, last.position, 0.0)


def test_a_package_brings_a_drive_that_can_stop(packages: Path) -> None:
    install(packages, "drive", "standing", STANDING)
    install(packages, "drive", "rolling", STANDING.replace("standing", "rolling").replace("def stop", "def roll"))
    assert DRIVES.make("standing", {"place": 0.25}, BODY).read(7) == Measurement(7, 0.35, 0.0)
    assert DRIVES.package("standing") == ("test-standing", "1.5")
    assert set(DRIVES) == {"simulated", "topic", "standing", "rolling"}
    with pytest.raises(InputError, match="give at least -1"):
        DRIVES.make("standing", {"place": -2.0}, BODY)
    with pytest.raises(InputError, match="has no method stop; repair the package"):
        DRIVES.make("rolling", {}, BODY)
