"""install.sh and uninstall.sh as root on a host with an /etc of its own: what systemd is told, and what is left."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from tests.hosts.cluster import hosts
from tests.hosts.stations import ACCOUNT, Checkout, Station
from tests.swarmabs_fleet.fleets import EXAMPLES, contents, edited

from swarmabs_config.fleet.loader import load_fleet
from swarmabs_fleet.bundle import deploy

pytestmark = [pytest.mark.system, pytest.mark.timeout(100), pytest.mark.usefixtures("possible")]

TUNNEL, TARGET = "wg-quick@floor0.service", "swarmabs-floor.target"


def test_a_tunnel_that_is_up_learns_who_no_longer_belongs_to_it(tmp_path: Path) -> None:
    checkout = Checkout.make(tmp_path)
    log = tmp_path / "log"
    for name, line in (("systemctl", f'echo "$*" >>{log}'), ("wg-quick", "exit 9")):
        (checkout.programs / name).write_text(f"#!/bin/sh\n{line}\n")
        (checkout.programs / name).chmod(0o755)
    text = EXAMPLES["tunnel"].read_text(encoding="utf-8") + f"installation: {{checkout: {checkout.folder}}}\n"

    with hosts(1) as (host,):
        station = Station(host, "base", tmp_path / "disks", checkout)
        before = contents(station.etc)

        def told(number: int, *changes: tuple[str, str]) -> list[str]:
            """Install what is deployed anew; return what systemd is told."""
            log.write_text("")
            file = edited(tmp_path / f"{number}.yaml", text, *changes)
            deploy(load_fleet(file), tmp_path / f"out{number}", tmp_path / "keys")
            station.run(tmp_path / f"out{number}" / "base" / "install.sh")
            return log.read_text().splitlines()

        def expected(verb: str) -> list[str]:
            enabled = [f"enable -- {unit}" for unit in (TUNNEL, TARGET)]
            return ["daemon-reload", enabled[0], f"{verb} -- {TUNNEL}", enabled[1]]

        assert told(0) == expected("start")
        assert told(1) == expected("start")
        # The key of a robot that was lost is made anew.
        (tmp_path / "keys" / "floor" / "wireguard" / "cart-2.key").unlink()
        assert told(2) == expected("reload-or-restart")
        # It ends by the files that have started it, before they are replaced.
        assert told(3, ("port: 51820", "port: 51821")) == [f"stop -- {TUNNEL}", *expected("start")]

        log.write_text("")
        station.run("/etc/swarmabs/floor/uninstall.sh")
        assert log.read_text().splitlines()[-2:] == [f"disable --now -- {TUNNEL}", "daemon-reload"]
        assert contents(station.etc) == before


SYSTEMCTL = """\
#!/bin/sh
# Keeps tunnels as wg-quick does, but for the interface.
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

    def __init__(self, station: Station, folder: Path, text: str) -> None:
        self.station, self._folder, self._text = station, folder, text
        self._count = 0

    def install(self, *changes: tuple[str, str], keys: bool = True) -> Path:
        """Deploy what differs by some changes, and install it; return the bundle."""
        self._count += 1
        file = edited(self._folder / f"{self._count}.yaml", self._text, *changes)
        output = self._folder / f"out{self._count}"
        deploy(load_fleet(file), output, self._folder / "keys" if keys else None)
        self.station.run(output / "base" / "install.sh")
        return output / "base"

    def refused(self, address: str) -> bool:
        """Tell whether the host's rules keep everybody from an address."""
        return f"to {address} blackhole" in self.station.host.ip("rule")

    def tunnels(self) -> set[str]:
        return {path.name for path in (self.station.etc / "wireguard").glob("*")}


def made_on(checkout: Checkout, systemctl: str) -> None:
    """Give hosts programs that stand in for those of systemd and wireguard-tools."""
    for name, text in (("systemctl", systemctl), ("wg-quick", "#!/bin/sh\nexit 9\n")):
        (checkout.programs / name).write_text(text)
        (checkout.programs / name).chmod(0o755)


CHANGES = {
    "another address": ("tunnel_address: 10.83.0.1}", "tunnel_address: 10.83.0.2}"),
    "another interface": ("interface: floor0", "interface: floor9"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_tunnel_and_fence_of_before_are_taken_down_as_they_were_put_up(change: str, tmp_path: Path) -> None:
    checkout = Checkout.make(tmp_path)
    made_on(checkout, SYSTEMCTL)
    text = EXAMPLES["tunnel"].read_text(encoding="utf-8") + f"installation: {{checkout: {checkout.folder}}}\n"
    with hosts(1) as (host,):
        installation = Installation(Station(host, "base", tmp_path / "disks", checkout), tmp_path, text)
        before, rules = contents(installation.station.etc), host.ip("rule")
        installation.install()
        assert installation.refused("10.83.0.1")
        assert "iif floor0 " in host.ip("rule")

        installation.install(CHANGES[change])
        if change == "another address":
            assert installation.refused("10.83.0.2") and not installation.refused("10.83.0.1")
            host.ip("route", "get", "10.83.0.1", "from", host.address, "oif", "eth0")
        else:
            assert installation.tunnels() == {"floor9.conf"}
            assert "iif floor9 " in host.ip("rule") and "floor0" not in host.ip("rule")
        installation.station.run("/etc/swarmabs/floor/uninstall.sh")
        assert host.ip("rule") == rules
        assert contents(installation.station.etc) == before


def test_a_fence_without_a_tunnel_goes_with_the_address_and_stays_down_if_it_was(tmp_path: Path) -> None:
    checkout = Checkout.make(tmp_path)
    made_on(checkout, SYSTEMCTL)
    text = EXAMPLES["lan"].read_text(encoding="utf-8") + f"installation: {{checkout: {checkout.folder}}}\n"
    moved = ("192.168.10.1,", "192.168.10.2,")
    with hosts(1) as (host,):
        installation = Installation(Station(host, "base", tmp_path / "disks", checkout), tmp_path, text)
        rules = host.ip("rule")
        installation.install(keys=False)
        installation.install(moved, keys=False)
        assert host.ip("rule") == rules
        installation.station.run("/etc/swarmabs/lan/fence.sh", "up")
        installation.install(keys=False)
        assert installation.refused("192.168.10.1") and not installation.refused("192.168.10.2")
        installation.station.run("/etc/swarmabs/lan/uninstall.sh")
        assert host.ip("rule") == rules


def test_the_account_of_the_nodes_can_read_its_bundle_or_is_refused(tmp_path: Path) -> None:
    if shutil.which("setpriv") is None:
        pytest.skip("there is no setpriv here, by which root acts as another account")
    checkout = Checkout.make(tmp_path)
    made_on(checkout, "#!/bin/sh\n")
    text = EXAMPLES["lan"].read_text(encoding="utf-8")
    lines = f"installation: {{checkout: {checkout.folder}, prefix: /etc/closed/bundles}}\n"
    with hosts(1) as (host,):
        station = Station(host, "base", tmp_path / "disks", checkout)
        installation = Installation(station, tmp_path, text + lines)
        closed = station.etc / "closed"
        closed.mkdir(mode=0o700)
        before = contents(station.etc)
        with pytest.raises(AssertionError, match=f"{ACCOUNT} cannot enter /etc/closed/bundles; let others enter it"):
            installation.install(keys=False)
        assert contents(station.etc) == before
        closed.chmod(0o755)
        bundle = installation.install(keys=False)
        account = ["setpriv", "--reuid", ACCOUNT, "--regid", "990", "--clear-groups", "--"]
        read = station.start(
            *account, "sh", "-c", "cat /etc/closed/bundles/lan/*/*", stdout=subprocess.PIPE, text=False
        )
        assert read.communicate()[0] == b"".join(
            path.read_bytes() for folder in ("dds", "nodes", "systemd") for path in sorted((bundle / folder).iterdir())
        )
        assert read.returncode == 0
