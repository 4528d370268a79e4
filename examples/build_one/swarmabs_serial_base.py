"""A drive for a base that communicates by a serial line, by the protocol of `firmware/robot/base.h`."""

from __future__ import annotations

import fcntl
import os
import re
import select
import termios
import tty
from binascii import crc_hqx
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from swarmabs_core.declaration import made_of, parameters_of, setting
from swarmabs_core.errors import InputError, RunError
from swarmabs_core.messages import Kind
from swarmabs_core.realtime.drives import Body, DriveType, Measurement

if TYPE_CHECKING:
    from swarmabs_core.parameters import Settings

LONGEST_LINE = 96
"""Longest line of the protocol with its end, characters."""
MOST_READS = 16
"""Largest number of reads of the device, of up to 4 KiB, at a time."""
DRIVING, SILENT, UNPLACED = range(3)
STATES = ("driving", "silent: it hears no commands", "unplaced: put the robot on its mark and press its button")
BAUDS = ("115200", "230400", "460800", "921600")
_ODOMETRY = re.compile(r"O,(\d{1,10}),(-?\d{1,10}),(-?\d{1,10}),(\d{1,10}),(\d{1,10}),([0-2]),(\d{1,5}),(\d{1,10})")
_MS, _US = 1_000_000, 1_000  # ns
_NUMBERS = 2**32


class Odometry(NamedTuple):
    """What a base measures and reports.

    Attributes
    ----------
    time : int
        Time of the base, us, modulo 2**32.
    position, velocity : int
        Along the x axis of the robot, um and um/s; of an encoder of the plane in millionths of a rad.
    number : int
        Number of the newest command that it accepted.
    since : int
        Time since it received that command, us.
    state : int
        `DRIVING`, `SILENT` or `UNPLACED`.
    battery : int
        mV.
    rejected : int
        Number of lines that it rejected.
    """

    time: int
    position: int
    velocity: int
    number: int
    since: int
    state: int
    battery: int
    rejected: int

    def stamp(self, now: int) -> int:
        """Return when this was measured, ns since 1970, never later than it was: the command may have been on its way.

        The clocks of host and base need not agree: the number of a command is its time by the host's clock.
        """
        age = (now // _MS - self.number) % _NUMBERS
        return min(now, (now // _MS - age) * _MS + self.since * _US)


def framed(text: str) -> bytes:
    """Return a line with its checksum and end."""
    data = text.encode("ascii")
    return b"%s*%04X\n" % (data, crc_hqx(data, 0xFFFF))


def odometry(line: bytes) -> Odometry | None:
    """Return the content of a line without its end, None if it is torn, garbled or something else."""
    text, star, checksum = line.rpartition(b"*")
    if not star or checksum != b"%04X" % crc_hqx(text, 0xFFFF):
        return None
    match = _ODOMETRY.fullmatch(text.decode("ascii", errors="replace"))
    return Odometry(*map(int, match.groups())) if match else None


class SerialBase:
    """A base at a serial device.

    Attributes
    ----------
    rejected, dropped : int
        Number of rejected lines of the base, and of commands for which the device had no room.

    Raises
    ------
    InputError
        If it is no serial device.
    RunError
        If it cannot be opened, or is in use by another process: systemd starts the node again until it can.
    """

    def __init__(self, device: str, baud: str) -> None:
        self.rejected = self.dropped = 0
        self._device = device
        self._rest = b""
        self._torn = False
        try:
            descriptor = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise RunError(
                f"{device} cannot be opened: {error.strerror}", "plug it in, and add this user to the group dialout"
            ) from error
        self._file = os.fdopen(descriptor, "r+b", buffering=0)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            tty.setraw(descriptor)
            settings = termios.tcgetattr(descriptor)
            settings[4] = settings[5] = getattr(termios, f"B{baud}")
            termios.tcsetattr(descriptor, termios.TCSANOW, settings)
            termios.tcflush(descriptor, termios.TCIFLUSH)
        except BlockingIOError:
            self.close()
            raise RunError(f"{device} is in use by another process", "end it") from None
        except termios.error as error:
            self.close()
            raise InputError(f"{device} is no serial device ({error.args[1]})", "correct its path") from error

    def close(self) -> None:
        """Close the device; the base then stops by itself."""
        self._file.close()

    def command(self, velocity: int, now: int) -> None:
        """Send a velocity, um/s; a command for which there is no room is dropped, and the base notices the silence.

        Raises
        ------
        RunError
            If the device is gone.
        """
        line = framed(f"V,{now // _MS % _NUMBERS},{velocity}")
        data = b"\n" + line if self._torn else line  # a new line must not continue one that was cut off
        try:
            count = self._file.write(data) or 0
        except OSError as error:
            raise self._gone() from error
        if count < len(data):
            self._torn = self._torn or count > 0
            self.dropped += 1
        else:
            self._torn = False

    def wait(self, longest: float) -> None:
        """Wait until something arrives, or for a time, s."""
        select.select([self._file], [], [], longest)

    def received(self) -> list[Odometry]:
        """Return what has arrived since the last call, the oldest first.

        Raises
        ------
        RunError
            If the device is gone.
        """
        data = self._rest
        for _ in range(MOST_READS):
            try:
                part = self._file.read(4096)
            except OSError as error:
                raise self._gone() from error
            if part is None:
                break
            if not part:
                raise self._gone()
            data += part
        *lines, rest = data.split(b"\n")
        self._rest = rest[:LONGEST_LINE]  # of a longer one the checksum then shows that it is none
        answers = [answer for answer in map(odometry, lines) if answer is not None]
        self.rejected += len(lines) - len(answers)
        return answers

    def _gone(self) -> RunError:
        return RunError(f"the base at {self._device} is gone", "plug it in, and start this node again")


@dataclass(frozen=True, slots=True)
class SerialSettings:
    """A base at a serial device."""

    device: str = setting("/dev/ttyACM0", "serial device of the base")
    baud: str = setting("230400", "its rate, which a USB device ignores", choices=BAUDS)
    offset: float = setting(0.0, "position of the mark where the robot is put down", unit="m")
    reversed: bool = setting(default=False, description="whether the robot faces the negative direction of the lane")
    scale: float = setting(1.0, "true distance over the distance that the base counts", above=0.0)


class SerialDrive:
    """Commands velocities, and measures the position along the lane.

    Parameters
    ----------
    settings : SerialSettings
        Device and calibration.

    Attributes
    ----------
    base : SerialBase
        The base.
    last : Odometry or None
        Its newest answer.
    """

    def __init__(self, settings: SerialSettings) -> None:
        self.base = SerialBase(settings.device, settings.baud)
        self._offset = settings.offset
        self._metres = (-settings.scale if settings.reversed else settings.scale) / 1e6  # per um of the base
        self.last: Odometry | None = None
        self._newest: Measurement | None = None
        self._age = 0

    def read(self, now: int) -> Measurement | None:
        """Return the newest measurement; those of a base that is not on its mark do not count."""
        for answer in self.base.received():
            self.last = answer
            if answer.state != UNPLACED:
                stamp = answer.stamp(now)
                self._age = now - stamp
                position = self._offset + self._metres * answer.position
                self._newest = Measurement(stamp, position, self._metres * answer.velocity)
        return self._newest

    def write(self, command: float, now: int) -> None:
        """Send a velocity, m/s along the lane."""
        self.base.command(round(command / self._metres), now)

    def stop(self) -> None:
        """Send zero; a base that is gone stops by itself."""
        with suppress(RunError):
            self.base.command(0, 0)

    def report(self) -> tuple[tuple[str, str], ...]:
        """Return what the diagnostics show of the base."""
        last = self.last
        own = (
            ("lines of the base rejected", str(self.base.rejected)),
            ("commands dropped", str(self.base.dropped)),
        )
        if last is None:
            return (*own, ("base", "nothing received yet"))
        return (
            *own,
            ("base", STATES[last.state]),
            ("commands rejected by the base", str(last.rejected)),
            ("battery, V", f"{last.battery / 1000:.2f}"),
            ("age of the last reading at most, ms", f"{self._age / _MS:.1f}"),
        )


def _make(settings: Settings, body: Body) -> SerialDrive:
    if body.kind is not Kind.SINGLE_INTEGRATOR:
        raise InputError("drive serial_base: the base takes velocities", "use the kind single_integrator")
    return SerialDrive(made_of(SerialSettings, settings))


SERIAL_BASE = DriveType("serial_base", parameters_of(SerialSettings), _make)
