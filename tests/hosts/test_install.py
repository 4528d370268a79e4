"""install.sh and uninstall.sh as root on a host with an /etc of its own: what systemd is told, and what is left."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.hosts.cluster import Host, hosts
from tests.hosts.stations import ACCOUNT, Checkout, Station
from tests.swarmabs_fleet.fleets import EXAMPLES, contents, edited, uses_keys

from swarmabs_config.fleet.loader import load_fleet
from swarmabs_fleet.bundle import deploy

pytestmark = [pytest.mark.system, pytest.mark.timeout(300), pytest.mark.usefixtures("possible")]

TUNNEL, TARGET = "wg-quick@floor0.service", "swarmabs-floor.target"


SYSTEMCTL = """\
#!/bin/sh
# Notes what it is told, and keeps tunnels as wg-quick does, but for the interface.
echo "$*" >>/etc/told
for name; do :; done
interface=${name#wg-quick@}
interface=${interface%.service}
run() { sh -c "$(sed -n "s/^$1 = //p" "/etc/wireguard/$interface.conf")"; }
down() { [ ! -e "/run/up-$interface" ] || { rm "/run/up-$interface" && run PostDown; }; }
case "$name" in wg-quick@*) ;; *) exit 0 ;; esac
case "$*" in
    "disable --now"* | stop*) down ;;
    start*) [ -e "/run/up-$interface" ] || { run PreUp && : >"/run/up-$interface"; } ;;
esac
"""


class Installation:
    """A host on which bundles are installed; its tunnels are files, and the fences in them are real."""

    def __init__(self, host: Host, folder: Path, example: str, settings: str = "") -> None:
        checkout = Checkout(folder)
        for name, text in (("systemctl", SYSTEMCTL), ("wg-quick", "#!/bin/sh\nexit 9\n")):
            (checkout.programs / name).write_text(text)
            (checkout.programs / name).chmod(0o755)
        self.station = Station(host, "base", folder / "disks", checkout)
        text = EXAMPLES[example].read_text(encoding="utf-8")
        self._text = f"{text}installation: {{checkout: {checkout.folder}{settings}}}\n"
        self.keys = folder / "keys" if uses_keys(example) else None
        self._folder, self._count = folder, 0
        self._before = contents(self.station.etc), host.ip("rule")

    def install(self, *changes: tuple[str, str]) -> Path:
        """Deploy what differs by some changes, and install it; return the bundle."""
        self._count += 1
        file = edited(self._folder / f"{self._count}.yaml", self._text, *changes)
        output = self._folder / f"out{self._count}"
        deploy(load_fleet(file), output, self.keys)
        self.station.run(output / "base" / "install.sh")
        return output / "base"

    def told(self) -> list[str]:
        """Return what systemd was told since this was asked for."""
        log = self.station.etc / "told"
        lines = log.read_text().splitlines()
        log.unlink()
        return lines

    def refused(self, address: str) -> bool:
        """Tell whether the host's rules keep everybody from an address."""
        return f"to {address} blackhole" in self.station.host.ip("rule")

    def nothing_is_left(self) -> bool:
        """Tell whether files and rules are what they were before."""
        (self.station.etc / "told").unlink(missing_ok=True)
        return (contents(self.station.etc), self.station.host.ip("rule")) == self._before


@pytest.fixture
def host() -> Iterator[Host]:
    with hosts(1) as (made,):
        yield made


def test_a_tunnel_that_is_up_learns_who_no_longer_belongs_to_it(host: Host, tmp_path: Path) -> None:
    installation = Installation(host, tmp_path, "tunnel")

    def expected(verb: str) -> list[str]:
        enabled = [f"enable -- {unit}" for unit in (TUNNEL, TARGET)]
        return ["daemon-reload", enabled[0], f"{verb} -- {TUNNEL}", enabled[1]]

    for _ in range(2):
        installation.install()
        assert installation.told() == expected("start")
    # The key of a robot that was lost is made anew.
    (tmp_path / "keys" / "floor" / "wireguard" / "cart-2.key").unlink()
    installation.install()
    assert installation.told() == expected("reload-or-restart")
    # It ends by the files that have started it, before they are replaced.
    installation.install(("port: 51820", "port: 51821"))
    assert installation.told() == [f"stop -- {TUNNEL}", *expected("start")]
    installation.station.run("/etc/swarmabs/floor/uninstall.sh")
    assert installation.told()[-2:] == [f"disable --now -- {TUNNEL}", "daemon-reload"]
    assert installation.nothing_is_left()


def test_tunnel_and_fence_of_before_are_taken_down_as_they_were_put_up(host: Host, tmp_path: Path) -> None:
    installation = Installation(host, tmp_path, "tunnel")
    installation.install()
    assert installation.refused("10.83.0.1")
    assert "iif floor0 " in host.ip("rule")

    address = ("tunnel_address: 10.83.0.1}", "tunnel_address: 10.83.0.2}")
    installation.install(address)
    assert installation.refused("10.83.0.2") and not installation.refused("10.83.0.1")
    host.ip("route", "get", "10.83.0.1", "from", host.address, "oif", "eth0")

    installation.install(address, ("interface: floor0", "interface: floor9"))
    assert {path.name for path in (installation.station.etc / "wireguard").iterdir()} == {"floor9.conf"}
    assert "iif floor9 " in host.ip("rule") and "floor0" not in host.ip("rule")
    installation.station.run("/etc/swarmabs/floor/uninstall.sh")
    assert installation.nothing_is_left()


def test_a_fence_without_a_tunnel_goes_with_the_address_and_stays_down_if_it_was(host: Host, tmp_path: Path) -> None:
    installation = Installation(host, tmp_path, "lan")
    rules = host.ip("rule")
    installation.install()
    installation.install(("192.168.10.1,", "192.168.10.2,"))
    assert host.ip("rule") == rules
    installation.station.run("/etc/swarmabs/lan/fence.sh", "up")
    installation.install()
    assert installation.refused("192.168.10.1") and not installation.refused("192.168.10.2")
    installation.station.run("/etc/swarmabs/lan/uninstall.sh")
    assert installation.nothing_is_left()


def test_a_place_that_the_account_of_the_nodes_cannot_enter_is_refused(host: Host, tmp_path: Path) -> None:
    if shutil.which("setpriv") is None:
        pytest.skip("there is no setpriv here, by which root acts as another account")
    installation = Installation(host, tmp_path, "lan", ", prefix: /etc/closed/bundles")
    station = installation.station
    closed = station.etc / "closed"
    closed.mkdir(mode=0o700)
    with pytest.raises(AssertionError, match=f"{ACCOUNT} cannot enter /etc/closed/bundles; run chmod"):
        installation.install()
    assert installation.nothing_is_left()
    closed.chmod(0o755)
    installation.install()
