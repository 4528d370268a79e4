"""A drive for a base that talks in UDP datagrams; the datagrams are described in README.md beside it."""

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
    """Hears the state of the base, and sends it commands."""

    def __init__(self, settings: Settings, body: Body) -> None:  # noqa: ARG002 - SI and DI have the same datagrams
        address = cast("str", settings["address"]), cast("int", settings["port"])
        self._delay = round(cast("float", settings["delay"]) * 1e9)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.socket.connect(address)  # from here on the kernel drops what others send
        except OSError as error:
            self.socket.close()
            raise InputError(f"drive.address: {address[0]!r} cannot be used ({error})") from error
        self.socket.setblocking(False)
        self._newest: Measurement | None = None
        self._refused = 0

    def read(self, now: int) -> Measurement | None:
        """Take what has arrived; its stamp is the time of arrival less the way here, since the base has no clock."""
        for _ in range(MOST_DATAGRAMS):
            try:
                datagram = self.socket.recv(64)
            except OSError:  # nothing there, or the base is: both show by the age of the measurement
                break
            self._take(datagram, now - self._delay)
        return self._newest

    def write(self, command: float, now: int) -> None:  # noqa: ARG002 - the base counts by itself when commands cease
        """Send a command."""
        self._send(command)

    def stop(self) -> None:
        """Send zero."""
        self._send(0.0)

    def report(self) -> tuple[tuple[str, str], ...]:
        """Return how many datagrams were refused; optional, for the diagnostics."""
        return (("datagrams refused", str(self._refused)),)

    def _take(self, datagram: bytes, stamp: int) -> None:
        if len(datagram) == STATE.size:
            count, position, velocity = STATE.unpack(datagram)
            if count > 0 and isfinite(position) and isfinite(velocity):
                self._newest = Measurement(stamp, position, velocity)
                return
        self._refused += 1

    def _send(self, command: float) -> None:
        try:
            self.socket.send(COMMAND.pack(command))
        except OSError:  # it stops by itself without commands
            return


SETTINGS = (
    Parameter("address", "192.168.42.1", "address of the base"),
    Parameter("port", 4242, "UDP port of the base", minimum=1, maximum=65535),
    Parameter("delay", 0.002, "time that a state is under way, s", minimum=0.0),
)
UDP_BASE = DriveType("udp_base", SETTINGS, UdpBase)
