"""A drive for a base that communicates by UDP datagrams, described in README.md."""

import socket
from math import isfinite
from struct import Struct
from typing import cast

from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter, Settings
from swarmabs_core.realtime.drives import Body, DriveType, Measurement

STATE = Struct("<qdd")
COMMAND = Struct("<d")
MOST_DATAGRAMS = 100


class UdpBase:
    """Receives the state of the base, and sends commands to it."""

    def __init__(self, settings: Settings, body: Body) -> None:  # noqa: ARG002 - the same for SI and DI
        address = cast("str", settings["address"]), cast("int", settings["port"])
        self._delay = round(cast("float", settings["delay"]) * 1e9)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.connect(address)  # from here on the kernel drops datagrams from others
        except OSError as error:
            self.socket.close()
            raise InputError(f"drive.address: {address[0]!r} cannot be used ({error})") from error
        self.socket.setblocking(False)
        self._newest: Measurement | None = None
        self._rejected = 0

    def read(self, now: int) -> Measurement | None:
        """Return the newest measurement, stamped with its arrival less the delay, because the base has no clock."""
        for _ in range(MOST_DATAGRAMS):
            try:
                datagram = self.socket.recv(64)
            except OSError:  # no datagram or no base: the age of the measurement shows both
                break
            self._take(datagram, now - self._delay)
        return self._newest

    def write(self, command: float, now: int) -> None:  # noqa: ARG002 - the base itself detects missing commands
        """Send a command."""
        self._send(command)

    def stop(self) -> None:
        """Send zero."""
        self._send(0.0)

    def report(self) -> tuple[tuple[str, str], ...]:
        """Return the number of rejected datagrams; optional, for the diagnostics."""
        return (("datagrams rejected", str(self._rejected)),)

    def _take(self, datagram: bytes, stamp: int) -> None:
        if len(datagram) == STATE.size:
            count, position, velocity = STATE.unpack(datagram)
            if count > 0 and isfinite(position) and isfinite(velocity):
                self._newest = Measurement(stamp, position, velocity)
                return
        self._rejected += 1

    def _send(self, command: float) -> None:
        try:
            self.socket.send(COMMAND.pack(command))
        except OSError:  # without commands the base stops by itself
            return


SETTINGS = (
    Parameter("address", "192.168.42.1", "address of the base"),
    Parameter("port", 4242, "UDP port of the base", minimum=1, maximum=65535),
    Parameter("delay", 0.002, "transmission delay of a state, s", minimum=0.0),
)
UDP_BASE = DriveType("udp_base", SETTINGS, UdpBase)
