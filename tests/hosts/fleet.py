"""A fleet on hosts of this machine, for people: it is deployed, installed, started, and then a storm passes over it.

Usage: python -m tests.hosts.fleet [--robots N] [--rounds N] [--seed SEED] [--discovery HOW] [--stay]

With --stay the fleet goes on until Ctrl-C, and lines say how to look at it and to touch it. It needs root, as all test
hosts do. All that it makes is gone at the end.
"""

from __future__ import annotations

import argparse
import signal
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from tests.hosts.cluster import Hosts, hosts
from tests.hosts.fleet_hosts import FleetOnHosts
from tests.hosts.namespaces import say, why_no_hosts
from tests.hosts.storm import Storm


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.hosts.fleet", description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=4, help="robots, each on a host of its own (2 to 20)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of the storm; 0: none")
    parser.add_argument("--seed", default="1", help="of all that happens")
    parser.add_argument("--discovery", choices=("static", "multicast", "server"), default="static")
    parser.add_argument("--stay", action="store_true", help="let the fleet go on until Ctrl-C")
    options = parser.parse_args()
    if not 2 <= options.robots <= 20:
        parser.error("--robots: 2 to 20")
    if reason := why_no_hosts():
        parser.error(reason)
    start = time.monotonic()

    def tell(line: str) -> None:
        say(f"{time.monotonic() - start:7.1f} s  {line}")

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        _run(options, tell)
    except KeyboardInterrupt:
        tell("interrupted; the fleet ends")
    return 0


def _run(options: argparse.Namespace, tell: Callable[[str], None]) -> None:
    with (
        tempfile.TemporaryDirectory(prefix="swarmabs-hosts-") as folder,
        hosts(1 + options.robots, seed=options.seed) as machines,
    ):
        quorum = max(2, options.robots - 1)
        fleet = FleetOnHosts(machines, Path(folder) / "fleet", quorum=quorum, discovery=options.discovery)
        tell(f"deployed {fleet.file}")
        fleet.install()
        fleet.start(*fleet.stations)
        tell(f"installed and started on {len(machines)} hosts")
        storm = Storm(machines, fleet, options.seed, tell)
        storm.settle()
        for number in range(options.rounds):
            storm.round(number)
            tell(f"round {number + 1}: no robot has left its lane or its limits, or moved on old data")
        if options.stay:
            _stay(fleet, machines)


def _stay(fleet: FleetOnHosts, machines: Hosts) -> None:
    """Say how to look at the fleet, and wait for Ctrl-C."""
    base = f"nsenter --target={machines[0].pid} --net --mount --uts --ipc --pid env HOME=/run TMPDIR=/run"
    say("On the base, from another terminal, as root:")
    for words in ("status", "stop", "reset"):
        say(f"  {base} {fleet.checkout.swarm} {words} {fleet.file}")
    for station in fleet.stations:
        say(f"{station.name}: process {station.host.pid}, {station.host.address}, logs in {station.etc / 'log'}")
    signal.pause()


if __name__ == "__main__":
    raise SystemExit(main())
