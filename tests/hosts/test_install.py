"""install.sh and uninstall.sh as root on a host with an /etc of its own: what systemd is told, and what is left."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.hosts.cluster import hosts
from tests.hosts.stations import Checkout, Station
from tests.swarmabs_bringup.fleet.fleets import EXAMPLES, contents, edited

from swarmabs_bringup.fleet.bundle import deploy
from swarmabs_bringup.fleet.loader import load_fleet

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
        assert told(3, ("port: 51820", "port: 51821")) == expected("restart")

        log.write_text("")
        station.run("/etc/swarmabs/floor/uninstall.sh")
        assert log.read_text().splitlines()[-2:] == [f"disable --now -- {TUNNEL}", "daemon-reload"]
        assert contents(station.etc) == before
